"""Judge: did the real tip enter the target box during the movement?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from stages.generate.space import Box

FINE = 0.0005  # [s]
LONGEST_GAP = 0.02  # [s] between readings over which the tip's way is still guessed


@dataclass(frozen=True)
class Verdict:
    """hit: the tip was in the box. t: time of the closest approach to its centre [s], and the
    distance there [m]; NaN where no tip was read."""

    hit: bool
    t: float
    distance: float


def judge(readings: pd.DataFrame, target: Box, duration: float) -> Verdict:
    """Follow the tip between frames (a cubic through the readings) for 0 <= t <= duration [s].

    readings: table READINGS. At 20 m/s and 200 frames a second the tip moves 100 mm from
    frame to frame, so frames alone would miss a hit.
    """
    good = readings[readings["valid"].astype(bool)]
    t, tip = good["t"].to_numpy(), good[["tip_x", "tip_y"]].to_numpy()
    if len(t) < 2:
        return Verdict(False, np.nan, np.nan)
    fine = np.arange(max(t[0], 0.0), min(t[-1], duration) + FINE / 2, FINE)
    gap = np.diff(t)[np.clip(np.searchsorted(t, fine, side="right") - 1, 0, len(t) - 2)]
    known = gap <= longest_gap(readings)
    if not known.any():
        return Verdict(False, np.nan, np.nan)
    way = CubicSpline(t, tip)(fine)
    inside = target.crossed(way[:-1], way[1:]) & known[1:] & known[:-1]
    away = np.where(known, target.away(way), np.inf)
    nearest = int(np.argmin(away))
    return Verdict(bool(inside.any()), float(fine[nearest]), float(away[nearest]))


def longest_gap(readings: pd.DataFrame) -> float:
    """Time between readings over which the tip's way is still guessed [s]: from frame to frame always."""
    frames = np.diff(np.sort(readings["t"].to_numpy()))
    return max(LONGEST_GAP, 1.01 * float(np.median(frames))) if len(frames) else LONGEST_GAP
