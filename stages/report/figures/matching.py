"""The matching rate over time."""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import Estimate
from stringcast.stages.report.figures.timeline import broken, mark_movement
from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.record import Cast
from stringcast.stages.report.words import rate


def matching(estimate: Estimate | None, cast: Cast | None = None) -> Picture | None:
    """E_f before and after an estimation, in the newest of the trials it saw."""
    if estimate is None or estimate.matching.empty:
        return None
    table = estimate.matching
    table = table[table["trial"] == table["trial"].iloc[-1]].sort_values("t")
    figure = framed(5.4, 2.7)
    axes = figure.subplots()
    t = table["t"].to_numpy()
    for name in ("before", "after"):
        axes.plot(t * MM, broken(t, table[name].to_numpy()), color=LIGHT[name], label=f"{name} estimation")
    if cast is not None:
        mark_movement(axes, cast)
    axes.set(xlabel="time [ms]", ylabel="matching rate E_f [1]", ylim=(0, 1.02))
    figure.legend(*axes.get_legend_handles_labels(), loc="upper left", ncols=3)
    means = [rate(float(np.nanmean(table[name]))) for name in ("before", "after")]
    return vector(figure, f"Matching rate over time: on average {means[0]} before estimation, {means[1]} after.")
