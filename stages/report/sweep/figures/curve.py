"""One outcome over one setting: each job, and the mean over the seeds with its interval."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from stringcast.stages.report.picture import LIGHT, Picture, powers, vector
from stringcast.stages.report.sweep.figures.levels import marked
from stringcast.stages.report.sweep.outcomes import Outcome, response
from stringcast.stages.report.words import significant

ALIKE = 1e-9  # relative; a geometric mean of equal values is off by 1e-15, which no axis can show


def curve(jobs: pd.DataFrame, outcome: Outcome, factor: str) -> Picture | None:
    """None where nothing is known of it. jobs: those that ended."""
    means = response(jobs, outcome, [factor])
    if means.empty:
        return None
    figure = Figure(figsize=(2.9, 2.2))
    axes = figure.subplots()
    place = marked(axes, jobs[factor])
    known = jobs[jobs[outcome.name].notna()]
    axes.plot(
        place(known[factor]), known[outcome.name] * outcome.scale, "o", ms=3, mew=0, color=LIGHT["wall"], alpha=0.5
    )
    x = place(means[factor])
    joined = "-" if pd.api.types.is_numeric_dtype(jobs[factor]) else "none"  # between words there is nothing
    axes.plot(x, means["mean"], "o", ls=joined, ms=4.5, color=LIGHT["after"])
    axes.vlines(x, means["low"], means["high"], color=LIGHT["after"], lw=4, alpha=0.35)
    low, high = axes.dataLim.intervaly
    if outcome.axis == "log" and high < low * (1 + ALIKE):
        axes.set_ylim(low / 2, high * 2)
    axes.set_yscale(outcome.axis)
    if outcome.axis == "log":
        axes.yaxis.set_major_formatter(powers())
        axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlabel(factor, fontsize=8)
    return vector(figure, _words(means, outcome, factor))


def _words(means: pd.DataFrame, outcome: Outcome, factor: str) -> str:
    """For those who cannot see it."""
    each = [f"{significant(row['mean'])}{_ends(row)} at {row[factor]}" for _, row in means.iterrows()]
    return f"{outcome.title} over {factor}: {', '.join(each)}."


def _ends(row: pd.Series) -> str:
    return f" ({significant(row['low'])} to {significant(row['high'])})" if np.isfinite(row["low"]) else ""
