"""Estimated parameters of strings A, B and C beside the paper's (Table 4)."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from stages.report.paper.record import Drawn, PaperRecord
from stages.report.picture import LIGHT, powers

SYMBOLS = ("k_h", "c_h", "k_ph", "c_ph")


def parameters(record: PaperRecord, conditions: Sequence[str]) -> Drawn | None:
    """A panel a parameter, a row a string; grey: the range searched, crosses: the paper."""
    whole = record.tables["parameters"]
    found = whole[whole["condition"].isin(conditions) & whole["symbol"].isin(SYMBOLS)]
    if found.empty:
        return None
    figure = Figure(figsize=(5.4, 4.4))
    for axes, symbol in zip(figure.subplots(2, 2).ravel(), SYMBOLS, strict=True):
        _panel(axes, found[found["symbol"] == symbol], record.tables["numbers"], conditions)
        axes.set_title(f"${symbol.replace('_', '_{')}}}$", fontsize=10)
    axes = figure.axes[0]
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return Drawn(figure, f"Estimated {', '.join(SYMBOLS)} of strings A, B and C, ours and the paper's.")


def _panel(axes: Axes, found: pd.DataFrame, printed: pd.DataFrame, conditions: Sequence[str]) -> None:
    symbol = found["symbol"].iloc[0]
    axes.axvspan(found["minimum"].min(), found["maximum"].max(), color=LIGHT["axis"], alpha=0.16, lw=0, label="range")
    for row, condition in enumerate(conditions):
        ours = found[found["condition"] == condition]
        label = "a run of ours" if row == 0 else None
        axes.plot(ours["value"], [row - 0.12] * len(ours), "o", color=LIGHT["after"], alpha=0.6, ms=5, label=label)
        theirs = printed[(printed["what"] == f"string {condition[-1]}") & (printed["of"] == symbol)]
        label = "the paper" if row == 0 else None
        axes.plot(theirs["value"], [row + 0.18], "x", color=LIGHT["before"], ms=7, mew=2, label=label)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(powers())
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_yticks(range(len(conditions)), [condition[-1] for condition in conditions])
    axes.set_ylim(len(conditions) - 0.5, -0.5)
    axes.set_xlabel(found["unit"].iloc[0], fontsize=8)
