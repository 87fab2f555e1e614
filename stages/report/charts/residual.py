"""Charts of residuals between simulated and measured strings, trial by trial."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import AsinhNorm, LinearSegmentedColormap
from matplotlib.figure import Figure

from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.charts.axes import add_legend_above, draw_map, new_axes
from stringcast.stages.report.charts.string_film import tip_points
from stringcast.stages.report.formatting import format_count, format_mm, join_names
from stringcast.stages.report.parts import Chart, Line
from stringcast.stages.report.records import (
    DiagnosisRecord,
    complex_residual,
    model_distances,
    trial_rms,
)
from stringcast.stages.report.theme import Picture, svg_picture

MODEL_COLOURS = {"base": "before", "extended": "after"}
# zero is transparent, and both ends are visible on light and dark pages
NEGATIVE_COLOUR, POSITIVE_COLOUR = (0.10, 0.50, 0.80), (0.93, 0.45, 0.08)
DIVERGING_COLOURS = LinearSegmentedColormap.from_list(
    "diverging",
    [
        (0, (*NEGATIVE_COLOUR, 1)),
        (0.5, (*NEGATIVE_COLOUR, 0)),
        (0.5, (*POSITIVE_COLOUR, 0)),
        (1, (*POSITIVE_COLOUR, 1)),
    ],
).with_extremes(bad=(0.55, 0.58, 0.62, 0.35))  # where nothing was measured
MIN_SCALE_SIGMAS = 5.0  # smallest end of the colour scale
COMPONENTS = {"normal": "across the string", "tangential": "along the string"}
MAP_WIDTH_IN = 5.4
MAP_ROW_IN = 1.05
MAP_TOP_IN = 0.45  # for titles
MAP_BOTTOM_IN = 0.95  # for the colour bar
SCALE_TICKS = (1, 3, 10, 30, 100, 300, 1000)


def model_labels(record: DiagnosisRecord) -> dict[str, str]:
    """Return the label of each simulated string for readers."""
    if not record.is_extended:
        return {"base": "simulated"}
    return {"base": "without the causes", "extended": "with the causes"}


# --- maps
def residual_maps(record: DiagnosisRecord, model: str) -> Picture | None:
    """Map the components of a model's residual over the noise floor, by trial."""
    trials = record.drawn_trials
    if not trials:
        return None
    figure, panels = _map_panels(len(trials))
    end = _scale_end(trials.values())
    colours = {"cmap": DIVERGING_COLOURS, "norm": AsinhNorm(2.0, -end, end)}
    length = record.model.string.length
    for row, (trial, table) in zip(panels, trials.items(), strict=True):
        s, t = table["s"].to_numpy(), table["t"].to_numpy()
        components = residual_components(table, model)
        for axes, name in zip(row, COMPONENTS, strict=True):
            values = components[name]
            drawn = draw_map(axes, s, t, values, length, **colours)
        row[0].set_ylabel("s [mm]")
        # above the row, because names may be longer than its height
        row[0].text(0.0, 1.05, trial, fontsize=8, transform=row[0].transAxes)
    _add_scale_bar(figure, drawn, end)
    trial_count = format_count(len(trials), "trial")
    words = f"Residuals of the {model} model over arc length and time in {trial_count}."
    return svg_picture(figure, words)


def _map_panels(row_count: int) -> tuple[Figure, np.ndarray]:
    """Return a figure with a row of axes for each trial, (rows, 2), and its axes.

    Its margins are fixed, because a layout that measures labels doubles the time.
    """
    height = MAP_TOP_IN + MAP_ROW_IN * row_count + MAP_BOTTOM_IN
    figure = Figure(figsize=(MAP_WIDTH_IN, height))
    figure.set_layout_engine("none")
    margins = {
        "left": 0.1,
        "right": 0.97,
        "top": 1 - MAP_TOP_IN / height,
        "bottom": MAP_BOTTOM_IN / height,
        "wspace": 0.12,
        "hspace": 0.4,
    }
    panels = figure.subplots(
        row_count, 2, sharex=True, sharey=True, squeeze=False, gridspec_kw=margins
    )
    for column, words in enumerate(COMPONENTS.values()):
        panels[0, column].set_title(words, fontsize=9, pad=16)
        panels[-1, column].set_xlabel("time [ms]")
    return figure, panels


def _add_scale_bar(figure: Figure, drawn: ScalarMappable, end: float) -> None:
    """Add the colour bar below all maps, from -end to end [noise floor]."""
    height = figure.get_figheight()
    place = figure.add_axes((0.1, 0.42 / height, 0.87, 0.08 / height))
    bar = figure.colorbar(drawn, cax=place, orientation="horizontal", extend="both")
    positive = [tick for tick in SCALE_TICKS if tick <= end]
    ticks = [*(-tick for tick in reversed(positive)), 0, *positive]
    bar.set_ticks(ticks, labels=[str(tick).replace("-", "−") for tick in ticks])
    bar.minorticks_off()
    bar.set_label("measured minus simulated [noise floor]")


def _scale_end(tables: Iterable[pd.DataFrame]) -> float:
    """Return the end of the colour scale of all trials and models."""
    sizes: list[np.ndarray] = []
    for table in tables:
        sizes += residual_components(table, "base").values()
    largest = np.quantile(np.abs(np.concatenate(sizes)), 0.99)
    return max(MIN_SCALE_SIGMAS, float(largest))


def residual_components(table: pd.DataFrame, model: str) -> dict[str, np.ndarray]:
    """Split a model's residual over the noise floor along the base model's string.

    The table has the components of the base model's residual. The string's direction
    follows from x + iy = direction * (tangential + i normal). Returns normal and
    tangential, (n,) each.
    """
    split = (table["base_tangential"] + 1j * table["base_normal"]).to_numpy()
    direction = np.ones(len(table), complex)  # where there is no residual
    is_known = np.abs(split) > 0
    np.divide(complex_residual(table, "base"), split, out=direction, where=is_known)
    rotated = complex_residual(table, model) / direction
    components = rotated / table["sigma"].to_numpy()
    return {"normal": components.imag, "tangential": components.real}


# --- over time
def residual_charts(record: DiagnosisRecord, table: pd.DataFrame) -> list[Chart]:
    """Chart the residual of each model in a trial, over the string and at the tip."""
    times, frame = np.unique(table["t"], return_inverse=True)
    counts = np.bincount(frame)

    def rms_by_frame(distances: np.ndarray) -> np.ndarray:
        return np.sqrt(np.bincount(frame, distances**2) / counts)

    ends = tip_points(table)
    whole, tip = [], []
    for model, label in model_labels(record).items():
        colour = MODEL_COLOURS[model]
        sizes = rms_by_frame(model_distances(table, model))
        whole.append(Line(label, sizes * MM_PER_M, colour))
        tip.append(Line(label, model_distances(ends, model) * MM_PER_M, colour))
    floor = np.sqrt(2) * rms_by_frame(table["sigma"].to_numpy())
    whole.append(Line("noise floor", floor * MM_PER_M, "soft", dashed=True))
    return [
        Chart("Residual", times, whole, "RMS [mm]"),
        Chart("Tip", ends["t"].to_numpy(), tip, "residual [mm]"),
    ]


# --- trial by trial
def trial_rms_picture(record: DiagnosisRecord) -> Picture | None:
    """Draw the residual in each trial, compared with noise and numerical error."""
    table = record.diagnosis.residuals
    if table.empty:
        return None
    residuals = {model: trial_rms(table, model) for model in record.models}
    names = residuals["base"].index
    rows = np.arange(len(names))
    variances = (table[["sigma", "total_sigma"]] ** 2).groupby(table["trial"]).mean()
    expected = np.sqrt(2 * variances) * MM_PER_M
    figure, axes = new_axes(5.4, 1.2 + 0.3 * len(names))
    label = "noise and numerical error"
    axes.barh(rows, expected["total_sigma"], height=0.7, color="grid", label=label)
    axes.plot(
        expected["sigma"], rows, "|", label="noise floor", ms=14, mew=1.6, color="ink"
    )
    labels = model_labels(record)
    for model, residual in residuals.items():
        label, colour = labels[model], MODEL_COLOURS[model]
        axes.plot(residual * MM_PER_M, rows, "o", ms=6, color=colour, label=label)
    axes.set(xlabel="residual, RMS [mm]", xlim=(0, None))
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    add_legend_above(figure, 2)
    largest = join_names(
        [f"{format_mm(r.max(), 1)} ({m})" for m, r in residuals.items()]
    )
    words = f"Residual in each trial against the noise floor: at most {largest}."
    return svg_picture(figure, words)
