"""What would have to be there to explain what is left."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.report.diagnosis.record import TRIALS, DiagnosisRecord
from stringcast.stages.report.picture import LIGHT, MM, Picture, vector
from stringcast.stages.report.words import significant

LONGEST = 0.28  # [inch] an arrow


def missing(record: DiagnosisRecord) -> Picture | None:
    """A row for each trial: arrows over time and arc length, or x and y over time for what acts on all of it."""
    table = record.diagnosis.missing.assign(size=lambda t: np.hypot(t["x"].fillna(0), t["y"].fillna(0)))
    if table.empty:
        return None
    shown = list(table.groupby("trial")["size"].max().sort_values(ascending=False).index[:TRIALS])
    rows = table[table["trial"].isin(shown)].fillna({"x": 0.0, "y": 0.0}).groupby("trial")
    figure = Figure(figsize=(6.0, 0.7 + 1.25 * len(rows)))
    panels = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    draw = _lines if table["s"].isna().all() else _arrows
    for axes, (trial, part) in zip(panels, rows, strict=True):
        draw(axes, part, float(table["size"].max()))
        axes.text(1.0, 1.0, trial, transform=axes.transAxes, ha="right", va="bottom", color=LIGHT["soft"])
    panels[-1].set_xlabel("time [ms]")
    top = table.loc[table["size"].idxmax()]
    words = f"strongest {significant(top['size'])} in trial {top['trial']} at {top['t'] * MM:.0f} ms"
    return vector(figure, f"The missing {top['kind']} over time in {len(rows)} trials; {words}.")


def _arrows(axes: Axes, part: pd.DataFrame, longest: float) -> None:
    """Arrows point as the force does in the plane, x to the right and y up."""
    place = (part["t"] * MM, part["s"] * MM)
    axes.plot(*place, ".", ms=1.5, color=LIGHT["axis"])
    arrows: dict[str, Any] = {"angles": "uv", "scale_units": "inches", "scale": longest / LONGEST, "width": 0.0022}
    axes.quiver(*place, part["x"], part["y"], color=LIGHT["target"], **arrows)
    axes.margins(0.06, 0.3)
    axes.set_ylabel("s [mm]")


def _lines(axes: Axes, part: pd.DataFrame, longest: float) -> None:
    """Along x and along y."""
    rows = part.sort_values("t")
    for axis, colour in (("x", LIGHT["target"]), ("y", LIGHT["measured"])):
        axes.plot(rows["t"] * MM, rows[axis] * MM, color=colour, label=axis)
    axes.axhline(0, color=LIGHT["axis"], lw=0.8)
    axes.set(ylabel="[mm]", ylim=np.array([-1.1, 1.1]) * longest * MM)
    axes.legend(loc="upper left", ncols=2)
