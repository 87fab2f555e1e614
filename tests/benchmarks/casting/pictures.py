"""The picture of a casting study.

It shows hits over casts, prediction errors, and whether predicted chances hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET
from tests.benchmarks.casting.scores import ALL_CASES, TARGET_SHARE
from tests.benchmarks.shares import error_bars

PANELS_PER_ROW = 5
MARKERS = "os^Dv<>"  # markers of methods; colours repeat after the fourth


def draw_hits(tables: Mapping[str, pd.DataFrame], path: Path) -> None:
    """Draw shares of hits and prediction errors over casts.

    `tables` are those of `score_casts`.
    """
    rates = tables["rates"]
    cases = [ALL_CASES, *(case for case in rates["case"].unique() if case != ALL_CASES)]
    rows = -(-(len(cases) + 2) // PANELS_PER_ROW)
    with plt.style.context(STYLE_SHEET):
        size = (2.4 * PANELS_PER_ROW, 2.7 * rows)
        figure, axes = plt.subplots(rows, PANELS_PER_ROW, figsize=size, squeeze=False)
        panels = list(axes.ravel())
        for panel, case in zip(panels, cases, strict=False):
            _draw_rates(panel, rates[rates["case"] == case], case)
        learned, predicted, *empty = panels[len(cases) :]
        errors = tables["learned"][tables["learned"]["case"] == ALL_CASES]
        for number, (_, group) in enumerate(errors.groupby("method", sort=False)):
            learned.plot(
                group["after"], group["median"] * MM_PER_M, f"{MARKERS[number]}-", ms=4
            )
        learned.set(
            xlabel="casts",
            ylabel="tip in other casts / mm",
            title="prediction error",
            yscale="log",
        )
        learned.yaxis.set_major_formatter("{x:g}")
        learned.yaxis.set_minor_formatter("{x:g}")
        learned.set_xticks(sorted(errors["after"].unique()))
        if len(tables["calibration"]):
            _draw_calibration(
                predicted, tables["calibration"], list(rates["method"].unique())
            )
        else:
            empty.append(predicted)  # no method predicts a probability
        for panel in empty:
            panel.set_axis_off()
        panels[0].legend(loc="lower right")
        figure.savefig(path, dpi=150, facecolor="white")
        plt.close(figure)


def _draw_rates(axes: Axes, rates: pd.DataFrame, case: str) -> None:
    for number, (method, group) in enumerate(rates.groupby("method", sort=False)):
        # shifted, so that error bars do not overlap
        casts = group["within"] + 0.08 * number
        axes.errorbar(
            casts,
            group["share"],
            error_bars(group),
            fmt=f"{MARKERS[number]}-",
            ms=4,
            label=method,
        )
    axes.axhline(TARGET_SHARE, color=LIGHT_COLOURS["wall"], ls="--", lw=1)
    axes.set(
        xlabel="casts", ylabel="runs that have hit", ylim=(-0.03, 1.05), title=case
    )
    axes.set_xticks(sorted(rates["within"].unique()))


def _draw_calibration(axes: Axes, table: pd.DataFrame, methods: list[str]) -> None:
    axes.plot([0, 1], [0, 1], color=LIGHT_COLOURS["wall"], ls="--", lw=1)
    for method, group in table.groupby("method", sort=False):
        number = methods.index(method)
        bars = error_bars(group)
        axes.errorbar(
            group["predicted"],
            group["share"],
            bars,
            fmt=MARKERS[number],
            ms=4,
            color=f"C{number}",
        )
    axes.set(
        xlabel="predicted probability",
        ylabel="share that hit",
        xlim=(0, 1.03),
        ylim=(-0.03, 1.05),
    )
    axes.set_title("do predictions hold?")
