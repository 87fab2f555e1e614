"""Estimated parameters of strings A, B and C beside the paper's (Table 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from stringcast.stages.report.paper.record import Drawn, PaperRecord
from stringcast.stages.report.picture import LIGHT, powers
from stringcast.stages.report.words import significant

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
    return Drawn(figure, " ".join(_words(found[found["symbol"] == symbol], record) for symbol in SYMBOLS))


def _words(found: pd.DataFrame, record: PaperRecord) -> str:
    """Medians of one parameter, string by string, and how often it lies at an end of its range."""
    symbol, printed = found["symbol"].iloc[0], record.tables["numbers"]
    theirs = printed[printed["of"] == symbol].set_index("what")["value"]
    said = [
        f"{name[-1]} {significant(some['value'].median())} (the paper {significant(theirs[f'string {name[-1]}'])})"
        for name, some in found.groupby("condition")
    ]
    ends = np.isclose(found["value"], found["minimum"]) | np.isclose(found["value"], found["maximum"])
    return f"{symbol}: {', '.join(said)}; at an end of its range in {ends.sum()} of {len(found)} runs."


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
