"""Pictures of a diagnosis study: the confusion matrix, and an overview with goals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET
from tests.benchmarks.shares import error_bars

COLOURS = {"effect": "after", "outside": "measured", "pair": "before", "triple": "wall"}
# answers that are no effect
VERDICTS = ("none", "unknown", "ambiguous", "insufficient", "failed")
KINDS = ("effect", "none", "outside")


def draw_pictures(tables: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Write `confusion.png` and `overview.png`, and return their paths.

    `tables` are those of `score_rows`.
    """
    figures = {"confusion": draw_confusion, "overview": draw_overview}
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, draw in figures.items():
        with plt.style.context(STYLE_SHEET):
            figure = draw(tables)
            paths.append(folder / f"{name}.png")
            figure.savefig(paths[-1], dpi=150, facecolor="white")
            plt.close(figure)
    return paths


def draw_confusion(tables: Mapping[str, pd.DataFrame]) -> plt.Figure:
    """Draw a matrix of hidden causes (rows) and answers (columns)."""
    counts = tables["confusion"]
    rows = []
    for kind in KINDS:
        rows += [
            (kind, truth)
            for truth in sorted(counts.loc[counts["kind"] == kind, "truth"].unique())
        ]
    answers = set(counts["answer"])
    causes = [truth for kind, truth in rows if kind == "effect"]
    verdicts = [
        verdict for verdict in VERDICTS if verdict in answers | {"none", "unknown"}
    ]
    columns = [*causes, *sorted(answers - {*causes, *VERDICTS}), *verdicts]
    matrix = counts.pivot_table(
        index=["kind", "truth"], columns="answer", values="count", aggfunc="sum"
    )
    shown = matrix.reindex(index=rows, columns=columns).fillna(0).to_numpy()
    figure, axes = plt.subplots(
        figsize=(2.6 + 0.28 * len(columns), 1.8 + 0.26 * len(rows))
    )
    axes.imshow(
        shown / shown.sum(axis=1, keepdims=True),
        cmap="Blues",
        vmin=0,
        vmax=1.4,
        aspect="auto",
    )
    for i, j in zip(*np.nonzero(shown), strict=True):
        axes.text(j, i, f"{shown[i, j]:.0f}", ha="center", va="center", fontsize=7)
    axes.set_xticks(
        range(len(columns)), columns, rotation=60, ha="right", rotation_mode="anchor"
    )
    axes.set_yticks(
        range(len(rows)), [t if k != "outside" else f"outside: {t}" for k, t in rows]
    )
    axes.set(xlabel="answer", ylabel="hidden")
    axes.set_xticks(np.arange(len(columns)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows)) - 0.5, minor=True)
    axes.grid(False)
    axes.grid(which="minor", color=LIGHT_COLOURS["grid"], linewidth=0.6)
    axes.tick_params(which="both", length=0)
    return figure


def draw_overview(tables: Mapping[str, pd.DataFrame]) -> plt.Figure:
    """Draw accuracy by size, calibration, rates with goals, and runtime."""
    figure = plt.figure(figsize=(10, 7.5))
    grid = figure.add_gridspec(2, 1)
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    left, right = upper.subplots(1, 2)
    wide, narrow = lower.subplots(1, 2, width_ratios=(1.3, 1))
    _draw_sizes(left, tables["by_size"])
    _draw_reliability(right, tables["calibration"], tables["calibration_error"].iloc[0])
    _draw_goals(wide, tables["rates"])
    seconds = tables["runtime"].iloc[0]
    narrow.hist(tables["diagnoses"]["runtime"], bins=30, color=LIGHT_COLOURS["after"])
    narrow.axvline(seconds["at_most"], color=LIGHT_COLOURS["wall"], ls="--", lw=1)
    narrow.set(xlabel="runtime of a diagnosis / s", ylabel="datasets", xlim=(0, None))
    narrow.set_title(
        f"median {seconds['median']:.0f} s, 95 % below {seconds['p95']:.0f} s"
    )
    return figure


def _draw_sizes(axes: Axes, table: pd.DataFrame) -> None:
    for number, (kind, some) in enumerate(table.groupby("kind")):
        # shifted, so that error bars do not overlap
        across = some["size"] * 1.02 ** (number - 1)
        axes.errorbar(
            across,
            some["share"],
            error_bars(some),
            fmt="o-",
            ms=4,
            color=LIGHT_COLOURS[COLOURS[kind]],
            label=kind,
        )
    axes.axhline(
        0.95, color=LIGHT_COLOURS["wall"], ls="--", lw=1, label="goal for effects"
    )
    axes.set_xscale("log")
    axes.set_xticks([5, 10, 20, 40], ["5", "10", "20", "40"])
    axes.minorticks_off()
    axes.set(
        xlabel="largest tip shift / noise sigma",
        ylabel="share that is right",
        ylim=(0, 1.05),
    )
    axes.set_title("right answers, by size")
    axes.legend(loc="lower right")


def _draw_reliability(axes: Axes, table: pd.DataFrame, error: pd.Series) -> None:
    axes.plot([0, 1], [0, 1], color=LIGHT_COLOURS["wall"], ls="--", lw=1)
    axes.errorbar(
        table["confidence"],
        table["share"],
        error_bars(table),
        fmt="o",
        ms=4,
        color=LIGHT_COLOURS["after"],
    )
    for x, low, count in table[["confidence", "low", "count"]].to_numpy():
        below = (0, -3)  # points
        axes.annotate(
            f"{count:.0f}",
            (x, low),
            below,
            textcoords="offset points",
            va="top",
            ha="center",
            fontsize=7,
        )
    axes.set(
        xlabel="stated probability",
        ylabel="share that is right",
        xlim=(0, 1.03),
        ylim=(-0.08, 1.05),
    )
    axes.set_title(
        f"calibration error {error['error']:.3f}, chance alone {error['chance']:.3f}"
    )


def _draw_goals(axes: Axes, table: pd.DataFrame) -> None:
    shown = table[table["count"] > 0].iloc[::-1].reset_index(drop=True)
    axes.errorbar(
        shown["share"],
        shown.index,
        xerr=error_bars(shown),
        fmt="o",
        ms=4,
        color=LIGHT_COLOURS["after"],
    )
    for place, row in shown.iterrows():
        for goal, mark in ((row["at_least"], ">"), (row["at_most"], "<")):
            if np.isfinite(goal):
                axes.plot(
                    goal,
                    place,
                    marker=mark,
                    color=LIGHT_COLOURS["before"],
                    ms=6,
                    ls="none",
                    clip_on=False,
                )
    axes.set_yticks(
        shown.index,
        shown["name"]
        + " ("
        + shown["right"].astype(str)
        + "/"
        + shown["count"].astype(str)
        + ")",
    )
    axes.set(
        xlim=(-0.03, 1.03),
        ylim=(-0.6, len(shown) - 0.4),
        xlabel="share, with 95 % interval; triangles: goals",
    )
