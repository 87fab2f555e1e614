"""Errors as arrows, all magnified alike."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

LENGTH = 0.04  # of the picture's width, of an arrow that is as long as the usual error


def magnified(corners: pd.DataFrame, width: int) -> float:
    """By how much errors are magnified: a round number that makes them seen. width: of the pictures [px]."""
    errors = np.hypot(corners["u"] - corners["fit_u"], corners["v"] - corners["fit_v"])
    ideal = LENGTH * width / max(float(np.sqrt(np.mean(errors**2))), 1e-6)
    step = 10.0 ** np.floor(np.log10(ideal))
    return float(step * max(s for s in (1, 2, 5) if s * step <= ideal))


def arrows(axes: Axes, corners: pd.DataFrame, times: float, colour: str) -> None:
    """From where the camera has each corner towards where it was seen."""
    shift = corners[["u", "v"]].to_numpy() - corners[["fit_u", "fit_v"]].to_numpy()
    at, along = (corners["fit_u"], corners["fit_v"]), (times * shift).T
    axes.quiver(*at, *along, color=colour, angles="xy", scale_units="xy", scale=1, width=0.004)
