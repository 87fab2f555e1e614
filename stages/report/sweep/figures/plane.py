"""One outcome over two settings, as a map of means."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from stringcast.stages.report.picture import LIGHT, Picture, vector
from stringcast.stages.report.sweep.figures.levels import named
from stringcast.stages.report.sweep.outcomes import Outcome, response
from stringcast.stages.report.words import significant

DARKEST = 0.75  # opacity of the largest mean, dark enough to see and light enough to read on


def plane(jobs: pd.DataFrame, outcome: Outcome, across: str, up: str) -> Picture | None:
    """None where nothing is known of it. jobs: those that ended. across, up: the settings."""
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
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, lw=0, facecolor=LIGHT["after"], alpha=shade))
        axes.text(x, y, significant(row["mean"]), ha="center", va="center", fontsize=8)
    axes.set_xticks(range(len(columns)), list(columns.values()), rotation=20, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), list(rows.values()))
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(-0.5, len(rows) - 0.5), xlabel=across, ylabel=up)
    axes.grid(False)
    axes.tick_params(length=0)
    return vector(figure, f"Mean {outcome.title} over {across} and {up}: {significant(low)} to {significant(high)}.")
