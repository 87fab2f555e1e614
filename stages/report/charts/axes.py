"""Axes, legends and maps shared by several charts."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, NullLocator

from stringcast.stages.common import MM_PER_M
from stringcast.stages.model.box import Box
from stringcast.stages.report.formatting import superscript
from stringcast.stages.report.theme import MS_PER_S

MAX_STRING_CELLS, MAX_TIME_CELLS = 30, 100
TARGET_STYLE: dict[str, Any] = {"fill": False, "edgecolor": "target", "lw": 1.8}
OBSTACLE_STYLE: dict[str, Any] = {"facecolor": "wall", "alpha": 0.5, "lw": 0}


def new_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """Create a figure of a size [inch] with one pair of axes."""
    figure = Figure(figsize=(width, height))
    return figure, figure.subplots()


def add_legend_above(figure: Figure, columns: int) -> None:
    """Add a legend of the first axes above all axes."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=columns)


def label_decades(axis: Axis) -> None:
    """Label a logarithmic axis by powers of ten only: 10⁻³."""

    def label(value: float, _: float) -> str:
        return "10" + superscript(f"{value:.0e}".split("e")[1])

    axis.set_major_formatter(FuncFormatter(label))
    axis.set_minor_locator(NullLocator())


def draw_map(
    axes: Axes,
    s: np.ndarray,
    t: np.ndarray,
    values: np.ndarray,
    length: float,
    **style: Any,
) -> ScalarMappable:
    """Draw mean values in cells of arc length and time.

    Cells without a point are empty. s, t, values: of each point (N,) [m], [s]. length:
    of the string, where the cells end [m]. style: colours of `Axes.pcolorfast`.
    """
    s_edges, t_edges = _string_edges(s, length), _time_edges(t)
    total, *_ = np.histogram2d(s, t, (s_edges, t_edges), weights=values)
    count, *_ = np.histogram2d(s, t, (s_edges, t_edges))
    means = np.full(total.shape, np.nan)
    np.divide(total, count, out=means, where=count > 0)
    axes.grid(visible=False)
    return axes.pcolorfast(t_edges * MS_PER_S, s_edges * MM_PER_M, means, **style)


def _string_edges(s: np.ndarray, length: float) -> np.ndarray:
    """Return edges [m] around the measured places, or even ones if there are many."""
    places = np.unique(np.round(s, 4))
    if len(places) > MAX_STRING_CELLS:
        return np.linspace(0, s.max() * (1 + 1e-9), MAX_STRING_CELLS + 1)
    if len(places) == 1:
        return np.array([0.0, max(length, places[0], 1e-3)])
    padded = np.pad(places, 1, mode="reflect", reflect_type="odd")
    edges = (padded[1:] + padded[:-1]) / 2
    return edges.clip(0.0, max(length, places[-1]))


def _time_edges(t: np.ndarray) -> np.ndarray:
    """Return even edges [s] at least a frame apart, so that gaps stay empty."""
    times = np.unique(t)
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.01
    width = max(frame, float(np.ptp(times)) / MAX_TIME_CELLS)
    return np.arange(times[0] - width / 2, times[-1] + width, width)


def draw_box(axes: Axes, box: Box, **style: Any) -> None:
    """Draw a target or obstacle in the plane, in mm."""
    corner = (box.centre - box.half_size) * MM_PER_M
    width, height = 2 * box.half_size * MM_PER_M
    axes.add_patch(Rectangle(corner, width, height, **style))
