"""How well the simulation foretold the first cast and a later one, over time (Fig. 14)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stringcast.stages.report.figures.timeline import broken
from stringcast.stages.report.paper.record import Drawn, PaperRecord
from stringcast.stages.report.picture import LIGHT, MM
from stringcast.stages.report.words import rate

LATER = 4  # the manipulation that the paper compares with the first
AROUND = 0.05  # [s] each side of the closest approach, over which E_f is averaged for comparison


def matching(record: PaperRecord, condition: str) -> Drawn | None:
    """E_f with the parameters with which each motion was made; dashed: the closest approach."""
    made = [number for number in record.casts(condition) if len(record.cast("matching", condition, number))]
    if not made:
        return None
    figure = Figure(figsize=(5.4, 3.0))
    axes = figure.subplots()
    near: dict[int, float] = {}
    for number, colour in zip(dict.fromkeys([made[0], compared(made)]), ("before", "after"), strict=False):
        table = record.cast("matching", condition, number).sort_values("t")
        t, rates = table["t"].to_numpy(), table["before"].to_numpy()
        axes.plot(t * MM, broken(t, rates), color=LIGHT[colour], label=f"manipulation {number}")
        closest = record.verdict(condition, number)["t_closest"]
        axes.axvline(closest * MM, color=LIGHT[colour], lw=1, ls="--")
        near[number] = float(np.nanmean(table.loc[(table["t"] - closest).abs() <= AROUND, "before"]))
    axes.set(xlabel="time [ms]", ylabel="matching rate E$_f$ [1]", ylim=(0, 1.02))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return Drawn(figure, _words(near))


def _words(near: dict[int, float]) -> str:
    """E_f around the closest approach, by manipulation, and whether it grew."""
    said = ", ".join(f"{rate(mean)} in manipulation {number}" for number, mean in near.items())
    first, last = next(iter(near.values())), list(near.values())[-1]
    grew = "" if len(near) < 2 else ": higher, as in the paper" if last > first else ": not higher, unlike in the paper"
    return f"Around the closest approach, 50 ms each side, E is {said}{grew}."


def compared(made: list[int]) -> int:
    """The manipulation that stands beside the first: the fourth, or the last before it."""
    return max(number for number in made if number <= LATER)
