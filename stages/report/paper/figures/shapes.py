"""The string as foretold and as filmed, at some moments of a cast (Figs. 7 to 9 and 11 to 13)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from stringcast.stages.report.paper.record import LABELS, Drawn, PaperRecord
from stringcast.stages.report.picture import LIGHT, MM
from stringcast.stages.report.words import mm

LOOK: dict[str, dict[str, Any]] = {
    "arm": {"color": LIGHT["soft"], "lw": 2.2, "marker": "o", "ms": 3},
    "foretold": {"color": LIGHT["before"], "lw": 1.5, "ls": (0, (3, 1.5))},
    "measured": {"color": LIGHT["measured"], "lw": 1.7},
}
CALLED = {"arm": "arm", "foretold": "string, simulated", "measured": "string, filmed"}


def shapes(record: PaperRecord, casts: Sequence[tuple[str, int]]) -> Drawn | None:
    """A panel a cast. casts: experiment and number of the manipulation."""
    if not casts:
        return None
    figure = Figure(figsize=(2.75 * max(len(casts), 2), 3.5))
    panels = np.atleast_1d(figure.subplots(1, len(casts), sharex=True, sharey=True))
    for axes, (condition, number) in zip(panels, casts, strict=True):
        _panel(axes, record, condition, number)
        axes.set_title(_title(record, condition, number), fontsize=8.5)
    panels[0].set_ylabel("y [mm]")
    figure.legend(*_legend(panels[0]), loc="outside upper left", ncols=3)
    said = [_title(record, *cast).replace("\n", ", ") for cast in casts]
    return Drawn(figure, f"Drawn are {'; '.join(said)}.")


def boxes(axes: Axes, of: pd.DataFrame) -> None:
    """Target and obstacles. of: table boxes."""
    for box in of.itertuples():
        corner = ((box.x - box.w / 2) * MM, (box.y - box.h / 2) * MM)
        target = box.kind == "target"
        look: dict[str, Any] = {"fc": LIGHT["wall"], "alpha": 0.5}
        look = {"fill": False, "ec": LIGHT["target"], "lw": 1.6} if target else look
        axes.add_patch(Rectangle(corner, box.w * MM, box.h * MM, zorder=3, **look))


def _panel(axes: Axes, record: PaperRecord, condition: str, number: int) -> None:
    """Fainter the earlier."""
    lines = record.cast("lines", condition, number)
    last = lines["moment"].max()
    for (moment, kind), line in lines.groupby(["moment", "kind"]):
        share = 0.25 + 0.75 * (moment / last) ** 2
        faint = share if kind != "arm" else 0.5 * share
        label = CALLED[kind] if moment == last else None
        axes.plot(line["x"] * MM, line["y"] * MM, alpha=faint, label=label, **LOOK[kind])
    boxes(axes, record.of("boxes", condition))
    axes.set(xlabel="x [mm]", aspect="equal")
    axes.locator_params(nbins=5)


def _title(record: PaperRecord, condition: str, number: int) -> str:
    verdict = record.verdict(condition, number)
    ended = "hit" if verdict["hit"] else f"missed by {mm(verdict['miss_m'])}"
    return f"{LABELS[condition]}\nmanipulation {number}, {ended}"


def _legend(axes: Axes) -> tuple[list[Any], list[str]]:
    """In the order of CALLED, with the target."""
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    names = [name for name in CALLED.values() if name in handles]
    return [handles[name] for name in names], names
