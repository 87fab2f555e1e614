"""The table as a picture: cost over n and over batch beside the machine's limit, and
every goal.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET

TICKS = (0.2, 0.5, 1, 2, 5)
COST = "ns per mass-point-step and core"


def picture(rows: pd.DataFrame, path: Path) -> None:
    """Draw the table and write it as `path`."""
    with plt.style.context(STYLE_SHEET):
        figure, (points, batch, goals) = plt.subplots(
            1, 3, figsize=(11, 3.6), width_ratios=(1, 1, 1.3)
        )
        _cost(
            points,
            rows[(rows["measure"] == COST) & (rows["subject"] != "engine, simulate")],
            "points",
        )
        _cost(
            batch,
            rows[(rows["measure"] == COST) & (rows["subject"] == "engine, simulate")],
            "batch",
        )
        points.set(
            xlabel="mass points",
            ylabel="ns per mass-point-step and core",
            title="step loop, 64 candidates",
        )
        batch.set(xlabel="candidates at once", title="simulate as a whole, 10 points")
        batch.set_xscale("log")
        limit = rows.loc[rows["subject"] == "limit of this machine", "value"].iloc[0]
        for axes in (points, batch):
            axes.axhline(limit, color=LIGHT_COLOURS["wall"], ls="--")
            axes.annotate(
                "limit of this machine",
                (0.98, limit),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="top",
            )
            axes.set_yscale("log")
            axes.set_ylim(1, None)
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter("")
        _goals(goals, rows)
        figure.savefig(path, dpi=150, facecolor="white")
        plt.close(figure)


def _cost(axes: Axes, rows: pd.DataFrame, over: str) -> None:
    for (name, some), colour in zip(
        rows.dropna(subset=[over]).groupby("subject"),
        ("after", "before", "measured"),
        strict=False,
    ):
        error = np.abs(some[["low", "high"]].to_numpy().T - some["value"].to_numpy())
        axes.errorbar(
            some[over],
            some["value"],
            error,
            fmt="o-",
            ms=4,
            color=LIGHT_COLOURS[colour],
            label=name,
        )
    axes.legend()


def _goals(axes: Axes, rows: pd.DataFrame) -> None:
    """How far each goal is reached or missed, on a scale where 1 is the goal."""
    some = rows[rows[["at_least", "at_most"]].notna().any(axis=1)].iloc[::-1]
    reached = some["value"] / some["at_least"]
    reached = reached.where(some["at_least"].notna(), some["at_most"] / some["value"])
    names = some["measure"] + ": " + some["subject"].str.split(", ").str[-1]
    colours = [
        LIGHT_COLOURS["measured"] if r >= 1 else LIGHT_COLOURS["before"]
        for r in reached
    ]
    axes.barh(names, reached - 1, left=1, color=colours)
    axes.axvline(1, color=LIGHT_COLOURS["ink"], lw=1)
    axes.set_xscale("log")
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.minorticks_off()
    axes.set(title="goals: right of the line is met", xlabel="reached / goal")
    axes.tick_params(axis="y", labelsize=7)
