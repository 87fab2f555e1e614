"""The study's picture.

It shows errors of each set of effects, and the tip error over time in held-out trials.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET

# colours of sets, in their order within a family
COLOURS = ("before", "target", "after", "measured")
PANELS_PER_ROW = 4


def draw_sets(
    table: pd.DataFrame, held_out: Mapping[tuple[str, str], pd.DataFrame], path: Path
) -> None:
    """Draw errors of all fits.

    `table` is SETS. `held_out` is table PREDICTED by string and set.
    """
    trials: list[tuple[str, str]] = []
    for (string, _), rows in held_out.items():
        trials += [
            (string, trial)
            for trial in rows["trial"].unique()
            if (string, trial) not in trials
        ]
    panel_rows = -(-len(trials) // PANELS_PER_ROW)
    strings = list(table["string"].unique())
    heights = [1.0 + 0.26 * len(strings), 2.0 * panel_rows]
    with plt.style.context(STYLE_SHEET):
        figure = plt.figure(figsize=(11, sum(heights)), layout="constrained")
        upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[
            :, 0
        ]
        left, right = upper.subplots(1, 2, sharex=True, sharey=True)
        _draw_errors(left, table, strings, "tip", "tip in fitted trials, rms / mm")
        _draw_errors(
            right, table, strings, "held_out_tip", "tip in held-out trials, rms / mm"
        )
        authors = (
            table.drop_duplicates("string")
            .set_index("string")
            .loc[strings, "authors_tip"]
        )
        left.plot(
            MM_PER_M * authors.to_numpy(dtype=float),
            range(len(strings)),
            "kx",
            label="their authors' model",
        )
        upper.legend(
            *left.get_legend_handles_labels(), loc="outside upper center", ncols=6
        )
        panels = lower.subplots(panel_rows, PANELS_PER_ROW, squeeze=False).ravel()
        for axes in panels[len(trials) :]:
            axes.set_axis_off()
        for axes, (string, trial) in zip(panels, trials, strict=False):
            sets = [rows for (name, _), rows in held_out.items() if name == string]
            _draw_tip_error(axes, sets, trial)
        figure.savefig(path, dpi=110, facecolor="white")
        plt.close(figure)


def _draw_tip_error(axes: Axes, sets: list[pd.DataFrame], trial: str) -> None:
    """Draw the tip error of each set in a held-out trial over time."""
    for number, rows in enumerate(sets):
        tip = rows[(rows["trial"] == trial) & (rows["s"] == rows["s"].max())]
        error = np.hypot(tip["predicted_x"] - tip["x"], tip["predicted_y"] - tip["y"])
        axes.plot(
            tip["t"],
            MM_PER_M * error,
            lw=1,
            color=LIGHT_COLOURS[COLOURS[number % len(COLOURS)]],
        )
    axes.set_title(trial, fontsize="small")
    axes.set(xlabel="time / s", ylabel="tip error / mm")


def _draw_errors(
    axes: Axes, table: pd.DataFrame, strings: list[str], column: str, label: str
) -> None:
    """Draw a row for each string, a marker for each set."""
    for laws, group in table.groupby("laws", sort=False):
        rows = [strings.index(name) for name in group["string"]]
        of_family = list(table.loc[table["string"] == group["string"].iloc[0], "laws"])
        colour = LIGHT_COLOURS[COLOURS[of_family.index(laws) % len(COLOURS)]]
        axes.plot(
            MM_PER_M * group[column], rows, "o", ms=5, color=colour, label=str(laws)
        )
    axes.set(xlabel=label, xscale="log", ylim=(len(strings) - 0.5, -0.5))
    axes.set_xticks([1, 3, 10, 30], ["1", "3", "10", "30"])
    axes.set_yticks(range(len(strings)), strings)
