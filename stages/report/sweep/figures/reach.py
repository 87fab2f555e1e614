"""Where targets can be hit: a map of the workspace, coloured by how many manipulations it takes."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stringcast.stages.report.picture import LIGHT, MM, Picture, vector

PLACE = ("target.x", "target.y")
FAINTEST = 0.15  # opacity of the most manipulations


def reach(jobs: pd.DataFrame, most: int) -> Picture:
    """A mark at each target: filled the darker, the fewer manipulations the median of its seeds took until the tip hit.

    jobs: those that ended, with columns target.x and target.y [m], state, hit, manipulations. most: of any job. Hollow:
    the median seed did not hit; crosses: no job ran to its end, mostly because the target is out of reach.
    """
    needed = jobs["manipulations"].where(jobs["hit"] == 1, np.inf).where(jobs["state"] == "done", np.nan)
    median = needed.groupby([jobs[name] for name in PLACE]).agg(_lower_median)
    figure = Figure(figsize=(4.4, 4.2))
    axes = figure.subplots()
    for (x, y), casts in median.items():
        _mark(axes, x * MM, y * MM, casts, most)
    axes.set(xlabel="x of the target [mm]", ylabel="y of the target [mm]", aspect="equal", adjustable="datalim")
    axes.margins(0.12)
    return vector(figure, _words(median))


def _lower_median(needed: pd.Series) -> float:
    """NaN where no seed's job ran to its end; infinite where more than half never hit."""
    known = np.sort(needed.dropna().to_numpy(float))
    return float(known[(len(known) - 1) // 2]) if len(known) else np.nan


def _mark(axes: Axes, x: float, y: float, casts: float, most: int) -> None:
    if np.isnan(casts):
        axes.plot(x, y, "x", color=LIGHT["wall"], ms=7)
    elif np.isinf(casts):
        axes.plot(x, y, "s", mfc="none", mec=LIGHT["before"], ms=17)
    else:
        shade = 1 - (1 - FAINTEST) * (casts - 1) / max(most - 1, 1)
        axes.plot(x, y, "s", color=LIGHT["after"], alpha=shade, mew=0, ms=18)
        axes.annotate(f"{casts:.0f}", (x, y), ha="center", va="center", fontsize=8, color=LIGHT["ink"])


def _words(median: pd.Series) -> str:
    hit, never = int(np.isfinite(median).sum()), int(np.isinf(median).sum())
    first = int((median == 1).sum())
    failed = int(median.isna().sum())
    return (
        f"Of {len(median)} targets {hit} were hit, {first} in the first cast; {never} were not, {failed} did not run."
    )
