"""Hit test: did the real tip enter the target box during the movement, with the string
clear of obstacles? And before it: can arm and string touch the target at all?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from stringcast.data.artifacts import Points
from stringcast.data.schema import DataError
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box

TIME_STEP_S = 0.0005  # [s]
MAX_GAP_S = 0.02  # [s] between readings over which the tip's way is still guessed


@dataclass(frozen=True)
class HitResult:
    """hit: the tip was in the box, and until then the string touched no obstacle. t:
    time of the closest approach to the box's centre [s], and the distance there [m];
    NaN where no tip was read. touched: frames of the movement in which the string lies
    in an obstacle.
    """

    hit: bool
    t: float
    distance: float
    touched: int = 0


def hit_test(
    seen: Points, target: Box, obstacles: Sequence[Box], duration: float
) -> HitResult:
    """Follow the tip between frames (a cubic through the readings) for 0 <= t <=
    duration [s].

    At 20 m/s and 200 frames a second the tip moves 100 mm from frame to frame, so
    frames alone would miss a hit. Obstacles are judged by the frames alone.
    """
    # times of the movement's frames in which the string lies in an obstacle [s]
    points = seen.points
    moving = points[(points["t"] >= 0) & (points["t"] <= duration)].sort_values(
        ["t", "s"]
    )
    place, frame = moving[["x", "y"]].to_numpy(), moving["t"].to_numpy()
    joined = frame[1:] == frame[:-1]
    crossed = [box.is_crossed_by(place[:-1], place[1:]) & joined for box in obstacles]
    touched = (
        np.unique(frame[1:][np.any(crossed, axis=0)])
        if crossed and len(frame)
        else np.empty(0)
    )

    t = seen.readings.loc[seen.readings["valid"].astype(bool), "t"].to_numpy()
    fine = (
        np.arange(max(t[0], 0.0), min(t[-1], duration) + TIME_STEP_S / 2, TIME_STEP_S)
        if len(t)
        else np.empty(0)
    )
    way = tip_path(seen.readings, fine)
    if not np.isfinite(way).any():
        return HitResult(False, np.nan, np.nan, len(touched))
    inside = np.concatenate([[False], target.is_crossed_by(way[:-1], way[1:])])
    entered = fine[np.argmax(inside)] if inside.any() else -np.inf
    away = np.where(np.isfinite(way[:, 0]), target.distance_to_centre(way), np.inf)
    nearest = int(np.argmin(away))
    clear = not (touched <= entered).any()
    return HitResult(
        bool(inside.any() and clear),
        float(fine[nearest]),
        float(away[nearest]),
        len(touched),
    )


def tip_path(readings: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """The tip at times (K,) [s], (K, 2) [m]: by a cubic through the readings, and
    carried on beyond them; NaN in gaps that are too long to guess, and where fewer than
    two were read. readings: table READINGS.
    """
    good = readings[readings["valid"].astype(bool)]
    read = good["t"].to_numpy()
    if len(read) < 2:
        return np.full((len(t), 2), np.nan)
    gap = np.diff(read)[
        np.clip(np.searchsorted(read, t, side="right") - 1, 0, len(read) - 2)
    ]
    way = CubicSpline(read, good[["tip_x", "tip_y"]])(t)
    # from frame to frame the way is always guessed; times of frames are rounded
    longest = max(
        MAX_GAP_S, 1.01 * float(np.median(np.diff(np.sort(readings["t"].to_numpy()))))
    )
    return np.where((gap <= longest)[:, None], way, np.nan)


def check_reach(target: Box, arm: Arm, string_length: float) -> None:
    """Refuse a target that the outstretched arm and string cannot touch."""
    reach = arm.reach + string_length
    gap = target.distance_to(*arm.base)
    if gap > reach:
        raise DataError(
            f"target ({target.x * 1e3:.0f}, {target.y * 1e3:.0f}) mm is out of reach: "
            f"{gap * 1e3:.0f} mm from the arm's base at ({arm.base[0] * 1e3:.0f}, {arm.base[1] * 1e3:.0f}) mm, "
            f"arm and string reach {reach * 1e3:.0f} mm. "
            "Choose target.x and target.y closer, or move arm.base."
        )
