"""One picture of a hit study: hits over casts, what was learned, and whether predicted
chances hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

from stringcast.pipeline.studies.counts import bars
from stringcast.pipeline.studies.hitting.scores import ALL, WANTED
from stringcast.stages.report.theme import LIGHT_COLOURS, MM_PER_M, STYLE_SHEET

ACROSS = 5  # pictures side by side
MARKS = "os^Dv<>"  # of methods, whose colours come again after the fourth


def picture(tables: Mapping[str, pd.DataFrame], path: Path) -> None:
    """Draw shares of hits, misfit and prediction error over casts into a PNG. tables:
    of `scores`.
    """
    cases = [ALL, *(case for case in tables["rates"]["case"].unique() if case != ALL)]
    rows = -(-(len(cases) + 2) // ACROSS)
    with plt.style.context(STYLE_SHEET):
        figure, axes = plt.subplots(
            rows, ACROSS, figsize=(2.4 * ACROSS, 2.7 * rows), squeeze=False
        )
        places = list(axes.ravel())
        for place, case in zip(places, cases, strict=False):
            _hits(place, tables["rates"][tables["rates"]["case"] == case], case)
        learned, predicted, *empty = places[len(cases) :]
        of_all = tables["learned"][tables["learned"]["case"] == ALL]
        for number, (_, some) in enumerate(of_all.groupby("method", sort=False)):
            learned.plot(
                some["after"], some["median"] * MM_PER_M, f"{MARKS[number]}-", ms=4
            )
        learned.set(
            xlabel="casts",
            ylabel="tip on other casts / mm",
            title="how well it predicts",
            yscale="log",
        )
        learned.set_xticks(sorted(of_all["after"].unique()))
        if len(tables["calibration"]):
            _calibration(
                predicted,
                tables["calibration"],
                list(tables["rates"]["method"].unique()),
            )
        else:
            empty.append(predicted)  # no method predicts a chance
        for place in empty:
            place.set_axis_off()
        places[0].legend(loc="lower right")
        figure.savefig(path, dpi=150, facecolor="white")
        plt.close(figure)


def _hits(axes: Axes, rates: pd.DataFrame, case: str) -> None:
    for number, (method, some) in enumerate(rates.groupby("method", sort=False)):
        # side by side, so that bars can be told apart
        across = some["within"] + 0.08 * number
        axes.errorbar(
            across,
            some["share"],
            bars(some),
            fmt=f"{MARKS[number]}-",
            ms=4,
            label=method,
        )
    axes.axhline(WANTED, color=LIGHT_COLOURS["wall"], ls="--", lw=1)
    axes.set(
        xlabel="casts", ylabel="runs that have hit", ylim=(-0.03, 1.05), title=case
    )
    axes.set_xticks(sorted(rates["within"].unique()))


def _calibration(axes: Axes, table: pd.DataFrame, methods: list[str]) -> None:
    axes.plot([0, 1], [0, 1], color=LIGHT_COLOURS["wall"], ls="--", lw=1)
    for method, some in table.groupby("method", sort=False):
        number = methods.index(method)
        axes.errorbar(
            some["foretold"],
            some["share"],
            bars(some),
            fmt=MARKS[number],
            ms=4,
            color=f"C{number}",
        )
    axes.set(
        xlabel="predicted chance",
        ylabel="share that hit",
        xlim=(0, 1.03),
        ylim=(-0.03, 1.05),
    )
    axes.set_title("do predicted chances hold?")
