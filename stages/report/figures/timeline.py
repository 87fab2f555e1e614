"""What figures over time have in common."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from stringcast.stages.hit_test import LONGEST_GAP
from stringcast.stages.report.picture import LIGHT, MM
from stringcast.stages.report.record import Cast


def broken(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values over times [s], NaN after each gap too long to draw a line across."""
    return np.where(np.diff(t, prepend=t[:1]) > LONGEST_GAP, np.nan, values)


def mark_movement(axes: Axes, cast: Cast) -> None:
    """Shade the arm's movement and mark the closest approach. The axis is in ms."""
    axes.axvspan(0, cast.motion.duration * MM, color=LIGHT["axis"], alpha=0.16, lw=0)
    if np.isfinite(cast.verdict.t):
        axes.axvline(cast.verdict.t * MM, color=LIGHT["target"], lw=1.2, ls="--", label="closest approach")
