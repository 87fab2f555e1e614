"""Outcomes of a sweep over its settings and over the workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from stringcast.stages.report.formatting import mean_with_interval, significant
from stringcast.stages.report.outcomes import Outcome, response
from stringcast.stages.report.theme import (
    LIGHT_COLOURS,
    MM_PER_M,
    Picture,
    powers,
    vector,
)

# a setting whose levels span more than this ratio has an axis in powers of ten
DECADES = 20
Place = Callable[[pd.Series], np.ndarray]


def named(values: pd.Series) -> dict[Any, str]:
    """The levels in order, and how they are written."""
    return {
        level: f"{level:g}" if pd.api.types.is_number(level) else str(level)
        for level in sorted(values.unique())
    }


def marked(axes: Axes, values: pd.Series) -> Place:
    """Mark the levels on the x axis, numbers at their place and words side by side.
    Returns where each value is.
    """
    levels = named(values)
    if not pd.api.types.is_numeric_dtype(values):
        axes.set_xticks(
            range(len(levels)),
            list(levels.values()),
            rotation=20,
            ha="right",
            rotation_mode="anchor",
        )
        axes.set_xlim(-0.5, len(levels) - 0.5)
        return lambda some: some.map(list(levels).index).to_numpy(float)
    if min(levels) > 0 and max(levels) / min(levels) > DECADES:
        axes.set_xscale("log")
    axes.set_xticks(list(levels), list(levels.values()))
    axes.xaxis.set_minor_locator(NullLocator())
    return lambda some: some.to_numpy(float)


# relative; a geometric mean of equal values is off by 1e-15, which no axis can show
ALIKE = 1e-9


def titled(factor: str, units: Mapping[str, str]) -> str:
    """A setting as it is written at an axis."""
    return f"{factor} [{units[factor]}]" if factor in units else factor


LONG = 28  # characters of a label that is higher than the axes of a curve


def curve(
    jobs: pd.DataFrame, outcome: Outcome, factor: str, units: Mapping[str, str]
) -> Picture | None:
    """A curve of an outcome over a setting; None where nothing is known of it. jobs:
    those that ended. units: of settings, by name.
    """
    means = response(jobs, outcome, [factor])
    if means.empty:
        return None
    figure = Figure(figsize=(2.9, 2.2))
    axes = figure.subplots()
    place = marked(axes, jobs[factor])
    known = jobs[jobs[outcome.name].notna()]
    axes.plot(
        place(known[factor]),
        known[outcome.name] * outcome.scale,
        "o",
        ms=3,
        mew=0,
        color=LIGHT_COLOURS["wall"],
        alpha=0.5,
    )
    x = place(means[factor])
    # between words there is nothing
    joined = "-" if pd.api.types.is_numeric_dtype(jobs[factor]) else "none"
    axes.plot(x, means["mean"], "o", ls=joined, ms=4.5, color=LIGHT_COLOURS["after"])
    axes.vlines(
        x, means["low"], means["high"], color=LIGHT_COLOURS["after"], lw=4, alpha=0.35
    )
    low, high = axes.dataLim.intervaly
    if outcome.axis == "log" and high < low * (1 + ALIKE):
        axes.set_ylim(low / 2, high * 2)
    axes.set_yscale(outcome.axis)
    if outcome.axis == "log":
        axes.yaxis.set_major_formatter(powers())
        axes.yaxis.set_minor_locator(NullLocator())
        # where a single power of ten, or none, would be all that is said
        if high < 10 * low:
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(
                FuncFormatter(lambda value, _: significant(value))
            )
    axes.set_xlabel(titled(factor, units), fontsize=8)
    axes.set_ylabel(outcome.title, fontsize=7 if len(outcome.title) > LONG else 8)
    each = ", ".join(
        f"{mean_with_interval(row)} at {row[factor]}"
        for row in means.to_dict("records")
    )
    return vector(figure, f"{outcome.title} over {factor}: {each}.")


# opacity of the largest mean, dark enough to see and light enough to read on
DARKEST = 0.75


def plane(
    jobs: pd.DataFrame, outcome: Outcome, across: str, up: str, units: Mapping[str, str]
) -> Picture | None:
    """A map of an outcome over two settings; None where nothing is known of it. jobs:
    those that ended. across, up: the settings. units: by their names.
    """
    means = response(jobs, outcome, [across, up])
    if means.empty:
        return None
    columns, rows = (named(jobs[factor]) for factor in (across, up))
    figure = Figure(figsize=(1.6 + 0.62 * len(columns), 1.0 + 0.4 * len(rows)))
    axes = figure.subplots()
    low, high = means["mean"].min(), means["mean"].max()
    for _, row in means.iterrows():
        x, y = list(columns).index(row[across]), list(rows).index(row[up])
        shade = DARKEST * (row["mean"] - low) / (high - low) if high > low else 0.0
        axes.add_patch(
            Rectangle(
                (x - 0.5, y - 0.5),
                1,
                1,
                lw=0,
                facecolor=LIGHT_COLOURS["after"],
                alpha=shade,
            )
        )
        axes.text(x, y, significant(row["mean"]), ha="center", va="center", fontsize=8)
    axes.set_xticks(
        range(len(columns)),
        list(columns.values()),
        rotation=20,
        ha="right",
        rotation_mode="anchor",
    )
    axes.set_yticks(range(len(rows)), list(rows.values()))
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(-0.5, len(rows) - 0.5))
    axes.set(xlabel=titled(across, units), ylabel=titled(up, units))
    axes.grid(False)
    axes.tick_params(length=0)
    return vector(
        figure,
        f"Mean {outcome.title} over {across} and {up}: {significant(low)} to {significant(high)}.",
    )


PLACE = ("target.x", "target.y")
FAINTEST = 0.15  # opacity of the most manipulations


def reach(jobs: pd.DataFrame, most: int) -> Picture:
    """A mark at each target: filled the darker, the fewer manipulations the median of
    its seeds took until the tip hit.

    jobs: those that ended, with columns target.x and target.y [m], state, hit,
    manipulations. most: of any job. Hollow: the median seed did not hit; crosses: no
    job ran to its end, mostly because the target is out of reach.
    """
    needed = (
        jobs["manipulations"]
        .where(jobs["hit"] == 1, np.inf)
        .where(jobs["state"] == "done", np.nan)
    )
    median = needed.groupby([jobs[name] for name in PLACE]).agg(_lower_median)
    figure = Figure(figsize=(4.4, 4.2))
    axes = figure.subplots()
    for place, casts in median.items():
        x, y = np.array(place) * MM_PER_M
        if np.isnan(casts):
            axes.plot(x, y, "x", color=LIGHT_COLOURS["wall"], ms=7)
        elif np.isinf(casts):
            axes.plot(x, y, "s", mfc="none", mec=LIGHT_COLOURS["before"], ms=17)
        else:
            shade = 1 - (1 - FAINTEST) * (casts - 1) / max(most - 1, 1)
            axes.plot(
                x, y, "s", color=LIGHT_COLOURS["after"], alpha=shade, mew=0, ms=18
            )
            axes.annotate(
                f"{casts:.0f}",
                (x, y),
                ha="center",
                va="center",
                fontsize=8,
                color=LIGHT_COLOURS["ink"],
            )
    axes.set(
        xlabel="x of the target [mm]",
        ylabel="y of the target [mm]",
        aspect="equal",
        adjustable="datalim",
    )
    axes.margins(0.12)
    hit, never, first = (
        int(some.sum()) for some in (np.isfinite(median), np.isinf(median), median == 1)
    )
    return vector(
        figure,
        f"Of {len(median)} targets {hit} were hit, {first} in the first cast; {never} were not, "
        f"{median.isna().sum()} did not run.",
    )


def _lower_median(needed: pd.Series) -> float:
    """NaN where no seed's job ran to its end; infinite where more than half never hit."""
    known = np.sort(needed.dropna().to_numpy(float))
    return float(known[(len(known) - 1) // 2]) if len(known) else np.nan
