"""Where and when a model is wrong: residuals over arc length and time, trial by trial."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import AsinhNorm
from matplotlib.figure import Figure

from stringcast.stages.report.diagnosis.figures.colours import DIVERGING, NAMES, NOTHING
from stringcast.stages.report.diagnosis.record import DiagnosisRecord
from stringcast.stages.report.picture import MM, Picture, framed, vector

PLACES, MOMENTS = 30, 80  # cells at most, along the string and in time
LEAST = 5.0  # standard deviations: the end of the colour scale is never nearer
PARTS = {"normal": "across the string", "tangential": "along the string"}


def maps(record: DiagnosisRecord, model: str) -> Picture | None:
    """A row for each trial: the normal and the tangential part of the residual, over the noise floor."""
    if not record.trials:
        return None
    rows = len(record.trials)
    figure = framed(5.4, 1.3 + 1.05 * rows, top=0.45, bottom=1.0, between=0.3)
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    end = _end(record)
    scale = AsinhNorm(2.0, -end, end)
    for line, (trial, table) in zip(panels, record.trials.items(), strict=True):
        split = parts(table, model)
        drawn = [_map(axes, table, split[part], scale) for axes, part in zip(line, PARTS, strict=True)]
        line[0].set_ylabel("s [mm]")
        # above the row, for names may be longer than it is high
        line[0].text(0.0, 1.05, trial, fontsize=8, transform=line[0].transAxes)
    for axes, words in zip(panels[0], PARTS.values(), strict=True):
        axes.set_title(words, fontsize=9, pad=16)
    for axes in panels[-1]:
        axes.set_xlabel("time [ms]")
    _bar(figure, drawn[0], end)
    return vector(figure, f"Residuals of the {NAMES[model]} over arc length and time in {rows} trials.")


def _bar(figure: Figure, drawn: ScalarMappable, end: float) -> None:
    """What the colours mean, below all panels."""
    place = (0.15, 0.46 / figure.get_figheight(), 0.8, 0.09 / figure.get_figheight())
    bar = figure.colorbar(drawn, cax=figure.add_axes(place), orientation="horizontal", extend="both")
    above = [tick for tick in (1, 3, 10, 30, 100, 300, 1000) if tick <= end]
    ticks = [*(-tick for tick in reversed(above)), 0, *above]
    bar.set_ticks(ticks, labels=[str(tick).replace("-", "−") for tick in ticks])
    bar.minorticks_off()
    bar.set_label("measured less simulated [noise floor]")


def parts(table: pd.DataFrame, model: str) -> dict[str, np.ndarray]:
    """Normal and tangential part of the residual over the noise floor, (n,) each, in the base string's directions.

    As complex numbers a residual is its two parts times the direction of the string.
    """
    base = (table["x"] - table["base_x"]) + 1j * (table["y"] - table["base_y"])
    split = table["base_tangential"] + 1j * table["base_normal"]
    direction = np.divide(base, split, out=np.ones(len(table), complex), where=np.abs(split) > 0)
    off = (table["x"] - table[f"{model}_x"]) + 1j * (table["y"] - table[f"{model}_y"])
    along = (off / direction / table["sigma"]).to_numpy()
    return {"normal": along.imag, "tangential": along.real}


def _end(record: DiagnosisRecord) -> float:
    """Of the colour scale, the same for all trials and models."""
    sizes = [np.abs(part) for table in record.trials.values() for part in parts(table, "base").values()]
    return max(LEAST, float(np.quantile(np.concatenate(sizes), 0.99)))


def _map(axes: Axes, table: pd.DataFrame, values: np.ndarray, scale: AsinhNorm) -> ScalarMappable:
    """Means in cells of arc length and time."""
    edges = _along(table["s"].to_numpy()), _over(table["t"].to_numpy())
    total, count = (np.histogram2d(table["s"], table["t"], edges, weights=w)[0] for w in (values, None))
    cells = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    axes.grid(visible=False)
    colours = DIVERGING.with_extremes(bad=NOTHING)
    return axes.pcolorfast(edges[1] * MM, edges[0] * MM, cells, cmap=colours, norm=scale)


def _along(s: np.ndarray) -> np.ndarray:
    """Edges of cells around the places measured, or even ones where there are many [m]."""
    places = np.unique(np.round(s, 4))
    if len(places) > PLACES:
        return np.linspace(0, s.max() * (1 + 1e-9), PLACES + 1)
    middle = (places[1:] + places[:-1]) / 2
    half = middle[0] - places[0] if len(middle) else max(places[0] / 4, 1e-3)
    last = places[-1] - middle[-1] if len(middle) else half
    return np.concatenate([[max(places[0] - half, 0)], middle, [places[-1] + last]])


def _over(t: np.ndarray) -> np.ndarray:
    """Edges of even cells, a frame or more each; gaps between frames stay empty [s]."""
    times = np.unique(t)
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.01
    width = max(frame, float(np.ptp(times)) / MOMENTS)
    return np.arange(times[0] - width / 2, times[-1] + width, width)
