"""Parameters and effects: found, searched, promising, alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import NullLocator

from stringcast.data.artifacts import Estimate
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.formatting import gain, plain, significant
from stringcast.stages.report.records import DiagnosisRecord, PaperFigure, PaperRecord
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    Picture,
    framed,
    powers,
    vector,
)


def history(parameter: Parameter, estimates: Sequence[Estimate]) -> Picture:
    """Estimates cast by cast, from the start value (0) on. Bars: 95 % intervals.
    Hollow: this data does not determine it.
    """
    tables = [estimate.parameters.set_index("name") for estimate in estimates]
    rows = pd.DataFrame([table.loc[parameter.name] for table in tables]).reset_index(
        drop=True
    )
    figure = framed(2.5, 1.55, left=0.5, top=0.16)
    axes = figure.subplots()
    lowest, highest = rows["minimum"].min(), rows["maximum"].max()
    axes.axhspan(lowest, highest, color=LIGHT_COLOURS["axis"], alpha=0.16, lw=0)
    axes.plot(
        np.arange(len(rows) + 1),
        [parameter.start, *rows["value"]],
        color=LIGHT_COLOURS["after"],
        lw=1.2,
    )
    axes.vlines(
        rows.index + 1,
        rows["low"],
        rows["high"],
        color=LIGHT_COLOURS["after"],
        lw=4,
        alpha=0.35,
    )
    for number, row in rows.iterrows():
        fill = LIGHT_COLOURS["after"] if row["determined"] else "none"
        axes.plot(
            int(number) + 1,
            row["value"],
            "o",
            ms=5,
            mec=LIGHT_COLOURS["after"],
            mfc=fill,
        )
    if lowest > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(powers())
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.ticklabel_format(axis="y", scilimits=(-2, 4))
    axes.set_xticks(range(len(rows) + 1))
    axes.set_xlim(-0.3, len(rows) + 0.3)
    axes.set_xlabel("estimation", fontsize=8)
    last = rows.iloc[-1]
    known = "" if last["determined"] else ", not determined by this data"
    return vector(
        figure,
        f"{parameter.name.replace('_', ' ')} from {significant(parameter.start)} at the start to "
        f"{significant(last['value'])} {parameter.unit} after {len(rows)} estimation(s){known}.",
    )


# --- effects
def cause(effect: type[Effect], values: Mapping[str, float]) -> Picture:
    """The law with the values found. values: of the effect's parameters, by own names."""
    figure = Figure(figsize=(3.4, 2.5))
    axes = figure.subplots()
    effect.plot(axes, values)
    # an effect draws grey lines and black arrows; these colours have a dark side
    for line in axes.lines:
        if line.get_color() in ("0.6", "0.7"):
            line.set_color(LIGHT_COLOURS["axis"])
    for arrows in axes.collections:
        arrows.set_facecolor(LIGHT_COLOURS["after"])
    return vector(
        figure,
        f"The law of {effect.name.replace('_', ' ')}: {effect.describe(values)}.",
    )


BARS = 14  # effects drawn at most, the most promising


def screenings(record: DiagnosisRecord) -> list[tuple[str, Picture]]:
    """Promised gains at each step of the search: beside nothing, and beside each part
    of the causes chosen.
    """
    chosen = set(record.extension.get("effects", ()))
    drawn = []
    for context, rows in record.diagnosis.screening.groupby("context", sort=False):
        if context and not set(filter(None, context.split(" + "))) < chosen:
            continue  # beside causes that were given up again
        best = rows.sort_values("predicted_gain", ascending=False, kind="stable").head(
            BARS
        )
        named = best["effect"].isin(record.diagnosis.causes["effect"]).to_numpy()
        names, values = (
            [plain(name) for name in best["effect"]],
            best["predicted_gain"].to_numpy(),
        )
        figure = Figure(figsize=(5.4, 0.7 + 0.23 * len(best)))
        axes = figure.subplots()
        bars = axes.barh(
            names,
            values,
            height=0.7,
            color=np.where(
                named, LIGHT_COLOURS["after"], LIGHT_COLOURS["axis"]
            ).tolist(),
        )
        axes.bar_label(
            bars,
            [gain(value) for value in values],
            padding=4,
            fontsize=8,
            color=LIGHT_COLOURS["soft"],
        )
        axes.set(
            xlabel="predicted gain of the log-likelihood",
            xlim=(0, 1.15 * max(values.max(), 1.0)),
        )
        axes.grid(visible=False, axis="y")
        axes.invert_yaxis()
        promised = ", ".join(
            f"{name} {gain(value)}"
            for name, value in zip(names[:3], values[:3], strict=False)
        )
        words = f"Predicted gains of effects, the largest first: {promised}."
        drawn.append((plain(context), vector(figure, words)))
    return drawn


def likeness(record: DiagnosisRecord) -> Picture | None:
    """A matrix with a cell for each two effects, the fuller the more alike they are;
    None where none were compared.
    """
    table = record.diagnosis.likeness
    if table.empty:
        return None
    names = list(dict.fromkeys([*table["other"], *table["effect"]]))
    place = {name: number for number, name in enumerate(names)}
    figure = Figure(figsize=(5.4, 1.6 + 0.34 * len(names)))
    axes = figure.subplots()
    for row in table.itertuples():
        across, down = sorted((place[row.effect], place[row.other]))
        colour = {"facecolor": LIGHT_COLOURS["after"], "alpha": 0.75 * row.cosine**2}
        axes.add_patch(
            Rectangle((across - 0.48, down - 0.46), 0.96, 0.92, lw=0, **colour)
        )
        axes.text(
            across, down, f"{row.cosine:.2f}", ha="center", va="center", fontsize=8
        )
    words = [plain(name) for name in names]
    axes.set(xlim=(-0.5, len(names) - 1.5), ylim=(len(names) - 0.5, 0.5))
    axes.set_xticks(
        np.arange(len(names) - 1),
        words[:-1],
        rotation=40,
        ha="right",
        rotation_mode="anchor",
    )
    axes.set_yticks(np.arange(1, len(names)), words[1:])
    axes.grid(visible=False)
    most = table.loc[table["cosine"].idxmax()]
    pair = f"{plain(most['effect'])} and {plain(most['other'])}, {most['cosine']:.2f}"
    return vector(
        figure, f"How alike {len(names)} effects are in this data; most of all {pair}."
    )


# --- Table 4 of the paper
SYMBOLS = ("k_h", "c_h", "k_ph", "c_ph")


def table_4(record: PaperRecord, conditions: Sequence[str]) -> PaperFigure | None:
    """A panel a parameter, a row a string; grey: the range searched, crosses: the
    paper.
    """
    whole = record.tables["parameters"]
    found = whole[whole["condition"].isin(conditions) & whole["symbol"].isin(SYMBOLS)]
    if found.empty:
        return None
    figure = Figure(figsize=(5.4, 4.4))
    printed, said = record.tables["numbers"], []
    for axes, symbol in zip(figure.subplots(2, 2).ravel(), SYMBOLS, strict=True):
        ours, theirs = (
            found[found["symbol"] == symbol],
            printed[printed["of"] == symbol].set_index("what")["value"],
        )
        _panel(axes, ours, printed, conditions)
        axes.set_title(f"${symbol.replace('_', '_{')}}}$", fontsize=10)
        medians = []
        for name, some in ours.groupby("condition"):
            paper = significant(theirs[f"string {name[-1]}"])
            medians.append(
                f"{name[-1]} {significant(some['value'].median())} (the paper {paper})"
            )
        ends = np.isclose(ours["value"], ours["minimum"]) | np.isclose(
            ours["value"], ours["maximum"]
        )
        said += [
            f"{symbol}: {', '.join(medians)}; at an end of its range in {ends.sum()} of {len(ours)} runs."
        ]
    axes = figure.axes[0]
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return PaperFigure(figure, " ".join(said))


def _panel(
    axes: Axes, found: pd.DataFrame, printed: pd.DataFrame, conditions: Sequence[str]
) -> None:
    symbol = found["symbol"].iloc[0]
    axes.axvspan(
        found["minimum"].min(),
        found["maximum"].max(),
        color=LIGHT_COLOURS["axis"],
        alpha=0.16,
        lw=0,
        label="range",
    )
    for row, condition in enumerate(conditions):
        ours = found[found["condition"] == condition]
        label = "a run of ours" if row == 0 else None
        axes.plot(
            ours["value"],
            [row - 0.12] * len(ours),
            "o",
            color=LIGHT_COLOURS["after"],
            alpha=0.6,
            ms=5,
            label=label,
        )
        theirs = printed[
            (printed["what"] == f"string {condition[-1]}") & (printed["of"] == symbol)
        ]
        label = "the paper" if row == 0 else None
        axes.plot(
            theirs["value"],
            [row + 0.18],
            "x",
            color=LIGHT_COLOURS["before"],
            ms=7,
            mew=2,
            label=label,
        )
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(powers())
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_yticks(range(len(conditions)), [condition[-1] for condition in conditions])
    axes.set_ylim(len(conditions) - 0.5, -0.5)
    axes.set_xlabel(found["unit"].iloc[0], fontsize=8)
