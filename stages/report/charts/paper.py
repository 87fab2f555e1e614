"""The paper's figures from the study's tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.common import MM_PER_M
from stringcast.stages.model.box import Box
from stringcast.stages.report.charts.axes import (
    OBSTACLE_STYLE,
    TARGET_STYLE,
    add_legend_above,
    draw_box,
    label_decades,
    new_axes,
)
from stringcast.stages.report.charts.cast import break_at_gaps
from stringcast.stages.report.formatting import format_mm, format_rate, format_value
from stringcast.stages.report.records import EXPERIMENT_LABELS, PaperFigure, PaperRecord
from stringcast.stages.report.theme import MS_PER_S

# --- shapes of the string
LINE_STYLES: dict[str, dict[str, Any]] = {
    "arm": {"color": "soft", "lw": 2.2, "marker": "o", "ms": 3},
    "foretold": {"color": "before", "lw": 1.5, "ls": (0, (3, 1.5))},
    "measured": {"color": "measured", "lw": 1.7},
}
LINE_LABELS = {
    "arm": "arm",
    "foretold": "string, simulated",
    "measured": "string, filmed",
}


def string_shapes_figure(
    record: PaperRecord, casts: Sequence[tuple[str, int]]
) -> PaperFigure | None:
    """Draw arm and string over time for each cast (experiment, number)."""
    if not casts:
        return None
    figure = Figure(figsize=(2.75 * max(len(casts), 2), 3.5))
    panels = figure.subplots(1, len(casts), sharex=True, sharey=True, squeeze=False)[0]
    titles = []
    for axes, (condition, number) in zip(panels, casts, strict=True):
        _draw_shapes(axes, record.cast_rows("lines", condition, number))
        _draw_boxes(axes, record, condition)
        title = _cast_title(record, condition, number)
        axes.set(xlabel="x [mm]", aspect="equal")
        axes.locator_params(nbins=5)
        axes.set_title(title, fontsize=8.5)
        titles.append(title.replace("\n", ", "))
    panels[0].set_ylabel("y [mm]")
    add_legend_above(figure, 3)
    return PaperFigure(figure, f"Drawn are {'; '.join(titles)}.")


def _draw_shapes(axes: Axes, lines: pd.DataFrame) -> None:
    """Draw the lines of each moment; earlier ones are fainter."""
    last = lines["moment"].max()
    for (moment, kind), line in lines.groupby(["moment", "kind"]):
        alpha = 0.25 + 0.75 * (moment / last) ** 2
        if kind == "arm":
            alpha *= 0.5
        label = LINE_LABELS[kind] if moment == last else None
        look = {"alpha": alpha, "label": label, **LINE_STYLES[kind]}
        axes.plot(line["x"] * MM_PER_M, line["y"] * MM_PER_M, **look)


def _draw_boxes(axes: Axes, record: PaperRecord, condition: str) -> None:
    for row in record.rows_of("boxes", condition).itertuples():
        style = TARGET_STYLE if row.kind == "target" else OBSTACLE_STYLE
        draw_box(axes, Box(row.x, row.y, row.w, row.h), zorder=3, **style)


def _cast_title(record: PaperRecord, condition: str, number: int) -> str:
    verdict = record.cast_verdict(condition, number)
    result = "hit" if verdict["hit"] else f"missed by {format_mm(verdict['miss_m'])}"
    return f"{EXPERIMENT_LABELS[condition]}\ncast {number}, {result}"


def hand_paths_figure(
    record: PaperRecord, conditions: Sequence[str]
) -> PaperFigure | None:
    """Draw the hand path of each experiment's last cast; a dot marks its start."""
    finished = [name for name in conditions if record.cast_numbers(name)]
    if not finished:
        return None
    figure, axes = new_axes(5.4, 4.9)
    rises = []
    for name, colour in zip(finished, ("after", "before", "measured"), strict=False):
        number = record.cast_numbers(name)[-1]
        hand = record.cast_rows("hands", name, number).sort_values("t")
        x, y = hand["x"].to_numpy() * MM_PER_M, hand["y"].to_numpy() * MM_PER_M
        axes.plot(x, y, color=colour, label=EXPERIMENT_LABELS[name])
        axes.plot(x[0], y[0], "o", color=colour, ms=5)
        _draw_boxes(axes, record, name)
        side = "above" if y[-1] > y[0] else "below"
        rises.append(
            f"{EXPERIMENT_LABELS[name]}: the hand ends {abs(y[-1] - y[0]):.0f} mm "
            f"{side}"
        )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
    add_legend_above(figure, 3)
    return PaperFigure(figure, f"Paths of the hand. {'; '.join(rises)} its start.")


# --- Fig. 14: the matching rate over time
COMPARED_CAST = 4  # compared with the first cast in the paper
HIT_HALF_WINDOW_S = 0.05  # around the closest approach, for the mean of E_f


def matching_figure(record: PaperRecord, condition: str) -> PaperFigure | None:
    """Draw E_f with the parameters of each motion; dashed: the closest approach."""
    tables = {}
    for number in record.cast_numbers(condition):
        table = record.cast_rows("matching", condition, number)
        if len(table):
            tables[number] = table.sort_values("t")
    if not tables:
        return None
    first = min(tables)
    compared = max(number for number in tables if number <= COMPARED_CAST)
    figure, axes = new_axes(5.4, 3.0)
    means, texts = [], []
    for number in sorted({first, compared}):
        t, rates = tables[number][["t", "before"]].to_numpy().T
        closest = record.cast_verdict(condition, number)["t_closest"]
        colour = "before" if number == first else "after"
        name = f"cast {number}"
        axes.plot(t * MS_PER_S, break_at_gaps(t, rates), color=colour, label=name)
        axes.axvline(closest * MS_PER_S, color=colour, lw=1, ls="--")
        is_near = np.abs(t - closest) <= HIT_HALF_WINDOW_S
        means.append(float(np.nanmean(rates[is_near])))
        texts.append(f"{format_rate(means[-1])} in {name}")
    axes.set(xlabel="time [ms]", ylabel="matching rate of a frame [1]", ylim=(0, 1.02))
    add_legend_above(figure, 2)
    words = f"Around the closest approach, 50 ms each side, E is {', '.join(texts)}"
    if means[-1] > means[0]:
        words += ": higher, as in the paper"
    elif len(means) > 1:
        words += ": not higher, unlike in the paper"
    return PaperFigure(figure, f"{words}.")


# --- Table 4: estimated parameters
TABLE_4_SYMBOLS = ("k_h", "c_h", "k_ph", "c_ph")


def table_4_figure(
    record: PaperRecord, conditions: Sequence[str]
) -> PaperFigure | None:
    """Draw each string's parameters, the searched range, and the paper's values."""
    table = record.tables["parameters"]
    table = table[table["condition"].isin(conditions)]
    if table.empty:
        return None
    numbers = record.tables["numbers"]
    figure = Figure(figsize=(5.4, 4.4))
    summary = []
    for axes, symbol in zip(figure.subplots(2, 2).flat, TABLE_4_SYMBOLS, strict=True):
        ours = table[table["symbol"] == symbol]
        printed = numbers[numbers["of"] == symbol].set_index("what")["value"]
        paper = {name: printed[f"string {name[-1]}"] for name in conditions}
        _draw_parameter(axes, ours, paper)
        axes.set_title(f"${symbol.replace('_', '_{')}}}$", fontsize=10)
        medians = []
        for name, value in ours.groupby("condition")["value"].median().items():
            of_paper = format_value(paper[name])
            medians.append(f"{name[-1]} {format_value(value)} (the paper {of_paper})")
        is_low = np.isclose(ours["value"], ours["minimum"])
        is_high = np.isclose(ours["value"], ours["maximum"])
        at_end = f"{(is_low | is_high).sum()} of {len(ours)} runs"
        summary.append(
            f"{symbol}: {', '.join(medians)}; at an end of its range in {at_end}."
        )
    add_legend_above(figure, 3)
    return PaperFigure(figure, " ".join(summary))


def _draw_parameter(axes: Axes, ours: pd.DataFrame, paper: dict[str, float]) -> None:
    low, high = ours["minimum"].min(), ours["maximum"].max()
    axes.axvspan(low, high, color="axis", alpha=0.16, lw=0, label="range")
    rows = ours["condition"].map(list(paper).index)
    label = "a run of ours"
    axes.plot(ours["value"], rows - 0.12, "o", color="after", alpha=0.6, label=label)
    rows_of_paper = np.arange(len(paper)) + 0.18
    style: dict[str, Any] = {"color": "before", "ms": 7, "mew": 2}
    axes.plot(list(paper.values()), rows_of_paper, "x", label="the paper", **style)
    axes.set_xscale("log")
    label_decades(axes.xaxis)
    axes.set_yticks(range(len(paper)), [condition[-1] for condition in paper])
    axes.set_ylim(len(paper) - 0.5, -0.5)
    axes.set_xlabel(ours["unit"].iloc[0], fontsize=8)
