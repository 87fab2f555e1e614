"""How the casts got better."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from stringcast.stages.report.picture import LIGHT, MM, Picture, framed, vector
from stringcast.stages.report.record import Record
from stringcast.stages.report.words import mm


def progress(record: Record) -> Picture | None:
    """The closest approach of each cast (filled: a hit), and E before and after its estimation."""
    if len(record.casts) < 2:
        return None
    figure = framed(5.4, 4.9)
    top, bottom = figure.subplots(2, 1, sharex=True)
    _distances(top, record)
    _rates(bottom, record)
    bottom.set_xticks(range(1, len(record.casts) + 1))
    bottom.set_xlim(0.6, len(record.casts) + 0.4)
    figure.legend(loc="upper left", ncols=4)
    closest = ", ".join(mm(cast.verdict.distance) for cast in record.casts)
    return vector(figure, f"Closest approach of the tip to the target's centre, cast by cast: {closest}.")


def _distances(axes: Axes, record: Record) -> None:
    distances = np.array([cast.verdict.distance for cast in record.casts]) * MM
    number = np.arange(1, len(distances) + 1)
    hits = np.array([cast.verdict.hit for cast in record.casts])
    axes.plot(number, distances, color=LIGHT["target"])
    for these, words, fill in ((~hits, "missed", "none"), (hits, "hit", LIGHT["target"])):
        if these.any():
            axes.plot(number[these], distances[these], "o", color=LIGHT["target"], label=words, mfc=fill)
    axes.set(ylabel="closest to centre [mm]", ylim=(0, None))


def _rates(axes: Axes, record: Record) -> None:
    for number, cast in enumerate(record.casts, start=1):
        if cast.estimate is not None:
            rates = cast.estimate.fit.iloc[0][["before", "after"]].astype(float)
            axes.plot([number, number], rates, color=LIGHT["axis"], lw=1.2, zorder=1)
            for name in ("before", "after"):
                label = f"{name} estimation" if number == 1 else ""
                axes.plot(number, rates[name], "o", color=LIGHT[name], label=label)
    axes.set(xlabel="cast", ylabel="matching rate E [1]", ylim=(0, 1.02))
