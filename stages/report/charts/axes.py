"""Axes, legends and cells that several charts share."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, NullLocator

from stringcast.stages.model.box import Box
from stringcast.stages.report.formatting import superscript
from stringcast.stages.report.theme import MM_PER_M

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
    """Label a logarithmic axis by powers of ten alone: 10⁻³."""

    def label(value: float, _: float) -> str:
        return "10" + superscript(f"{value:.0e}".split("e")[1])

    axis.set_major_formatter(FuncFormatter(label))
    axis.set_minor_locator(NullLocator())


def mean_in_cells(
    positions: tuple[np.ndarray, np.ndarray],
    values: np.ndarray,
    edges: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Average values in the cells of a grid.

    Parameters
    ----------
    positions : two ndarrays, shape (N,)
        Coordinates of the values, such as arc length and time.
    values : ndarray, shape (N,)
    edges : two ndarrays, shape (R + 1,) and (C + 1,)
        Edges of the cells along each coordinate.

    Returns
    -------
    ndarray, shape (R, C)
        NaN in empty cells.
    """
    total, *_ = np.histogram2d(*positions, edges, weights=values)
    count, *_ = np.histogram2d(*positions, edges)
    empty = np.full(total.shape, np.nan)
    return np.divide(total, count, out=empty, where=count > 0)


def draw_box(axes: Axes, box: Box, **style: Any) -> None:
    """Draw a target or obstacle in the plane, in mm."""
    corner = ((box.x - box.w / 2) * MM_PER_M, (box.y - box.h / 2) * MM_PER_M)
    axes.add_patch(Rectangle(corner, box.w * MM_PER_M, box.h * MM_PER_M, **style))
