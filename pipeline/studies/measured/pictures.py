"""The study's picture: how near each set comes to each string, and how far off the tip
is in trials held out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from stringcast.stages.report.theme import LIGHT_COLOURS, MM_PER_M, STYLE_SHEET

# of sets, in their order within a family
COLOURS = ("before", "target", "after", "measured")
ACROSS = 4  # trials side by side


def picture(
    table: pd.DataFrame, held_out: Mapping[tuple[str, str], pd.DataFrame], path: Path
) -> None:
    """Write it. table: SETS. held_out: table PREDICTED of each string and set."""
    trials = list(
        dict.fromkeys(
            (s, trial)
            for (s, _), rows in held_out.items()
            for trial in rows["trial"].unique()
        )
    )
    below = -(-len(trials) // ACROSS)
    strings = list(table["string"].unique())
    height = 1.0 + 0.26 * len(strings)
    with plt.style.context(STYLE_SHEET):
        figure = plt.figure(figsize=(11, height + 2.0 * below), layout="constrained")
        above, trace = figure.subfigures(
            2, 1, squeeze=False, height_ratios=[height, 2.0 * below]
        )[:, 0]
        left, right = above.subplots(1, 2, sharex=True, sharey=True)
        _tips(left, table, strings, "tip", "tip in sample, rms / mm")
        _tips(right, table, strings, "held_out_tip", "tip in trials held out, rms / mm")
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
        above.legend(
            *left.get_legend_handles_labels(), loc="outside upper center", ncols=6
        )
        places = trace.subplots(below, ACROSS, squeeze=False).ravel()
        for axes in places[len(trials) :]:
            axes.set_axis_off()
        for axes, (string, trial) in zip(places, trials, strict=False):
            sets = [rows for (name, _), rows in held_out.items() if name == string]
            for number, rows in enumerate(sets):
                tip = rows[(rows["trial"] == trial) & (rows["s"] == rows["s"].max())]
                off = np.hypot(
                    tip["predicted_x"] - tip["x"], tip["predicted_y"] - tip["y"]
                )
                axes.plot(
                    tip["t"],
                    MM_PER_M * off,
                    lw=1,
                    color=LIGHT_COLOURS[COLOURS[number % len(COLOURS)]],
                )
            axes.set_title(trial, fontsize="small")
            axes.set(xlabel="time / s", ylabel="tip off / mm")
        figure.savefig(path, dpi=110, facecolor="white")
        plt.close(figure)


def _tips(
    axes: Axes, table: pd.DataFrame, strings: list[str], column: str, label: str
) -> None:
    """A row for each string, a mark for each set."""
    for laws, some in table.groupby("laws", sort=False):
        place = [strings.index(name) for name in some["string"]]
        # sets of a string that has this one
        alike = list(table.loc[table["string"] == some["string"].iloc[0], "laws"])
        colour = LIGHT_COLOURS[COLOURS[alike.index(laws) % len(COLOURS)]]
        axes.plot(
            MM_PER_M * some[column], place, "o", ms=5, color=colour, label=str(laws)
        )
    axes.set(xlabel=label, xscale="log", ylim=(len(strings) - 0.5, -0.5))
    axes.set_xticks([1, 3, 10, 30], ["1", "3", "10", "30"])
    axes.set_yticks(range(len(strings)), strings)
