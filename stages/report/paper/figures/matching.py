"""How well the simulation foretold the first cast and a later one, over time (Fig. 14)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stages.report.paper.record import Drawn, PaperRecord
from stages.report.picture import LIGHT, MM

LATER = 4  # the manipulation that the paper compares with the first


def matching(record: PaperRecord, condition: str) -> Drawn | None:
    """E_f with the parameters with which each motion was made; dashed: the closest approach."""
    made = [number for number in record.casts(condition) if len(record.cast("matching", condition, number))]
    if not made:
        return None
    figure = Figure(figsize=(5.4, 3.0))
    axes = figure.subplots()
    means = []
    for number, colour in zip(dict.fromkeys([made[0], compared(made)]), ("before", "after"), strict=False):
        table = record.cast("matching", condition, number).sort_values("t")
        axes.plot(table["t"] * MM, table["before"], color=LIGHT[colour], label=f"manipulation {number}")
        axes.axvline(record.verdict(condition, number)["t_closest"] * MM, color=LIGHT[colour], lw=1, ls="--")
        means.append(f"{np.nanmean(table['before']):.3f} in manipulation {number}")
    axes.set(xlabel="time [ms]", ylabel="matching rate E$_f$ [1]", ylim=(0, 1.02))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return Drawn(figure, f"Matching rate over time: on average {', '.join(means)}.")


def compared(made: list[int]) -> int:
    """The manipulation that stands beside the first: the fourth, or the last before it."""
    return max(number for number in made if number <= LATER)
