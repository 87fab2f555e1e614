"""Hit test: whether the real tip entered the target with the string clear of obstacles.

Before a cast: whether arm and string can reach the target at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from stringcast.data.artifacts import Points
from stringcast.data.schema import DataError
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.target import Target

TIME_STEP_S = 0.0005  # of the tip's path
MAX_GAP_S = 0.02  # between readings across which the tip's path is interpolated
MAX_ROUNDED_INTERVAL = 1.01  # of frames, whose times are rounded, over the median


@dataclass(frozen=True)
class HitResult:
    """Result of the hit test.

    Parameters
    ----------
    hit : whether the tip was in the target, and until then the string touched nothing
    t : time of the closest approach to the target's centre [s]; NaN without a tip
    distance : of the tip from the centre at that time [m]; NaN without a tip
    touched : number of frames of the movement in which the string lies in an obstacle
    speed : of the tip at that time [m/s]; NaN without a tip
    direction : of its velocity, counter-clockwise from x [rad]; NaN without a tip
    entered : whether the tip was in the box, however it moved
    """

    hit: bool
    t: float
    distance: float
    touched: int = 0
    speed: float = np.nan
    direction: float = np.nan
    entered: bool = False

    @classmethod
    def unknown(cls) -> HitResult:
        """Return the result of a trial whose tip is not known."""
        return cls(False, np.nan, np.nan)


def hit_test(
    seen: Points, target: Target, obstacles: Sequence[Box], duration: float
) -> HitResult:
    """Test whether the tip enters the target during the movement.

    The tip is followed between frames by a cubic through the readings: at 20 m/s and
    200 frames a second it moves 100 mm from frame to frame, so frames alone would miss
    a hit. Contact with obstacles is judged by the frames alone.

    Parameters
    ----------
    seen : Points
        Points and readings of the frames.
    target : Target
        Box that the tip shall enter [m], and how it shall arrive.
    obstacles : sequence of Box
        Boxes that the string may not touch before [m].
    duration : float
        Duration of the movement, which starts at 0 [s].

    Returns
    -------
    HitResult
        Hit, closest approach and frames with contact.
    """
    contact_times = _contact_times(seen.points, obstacles, duration)

    # the tip's path in steps of TIME_STEP_S, from the first to the last reading
    readings = seen.readings
    t = readings.loc[readings["valid"].astype(bool), "t"].to_numpy()
    times = np.empty(0)
    if len(t):
        end = min(t[-1], duration) + TIME_STEP_S / 2
        times = np.arange(max(t[0], 0.0), end, TIME_STEP_S)
    path = tip_path(readings, times)
    if not np.isfinite(path).any():
        return replace(HitResult.unknown(), touched=len(contact_times))

    # it hits if it enters the target before the string touches anything
    inside = np.append(False, target.is_entered_along(path, TIME_STEP_S))
    hit = bool(inside.any())
    if hit and len(contact_times):
        hit = contact_times[0] > times[np.argmax(inside)]

    # the closest approach, among the times in the target if its arrival matters
    is_known = np.isfinite(path[:, 0])
    if target.restricts_arrival and inside.any():
        is_known &= inside  # it may pass nearer in another direction, without a hit
    distance = np.where(is_known, target.distance_to_centre(path), np.inf)
    nearest = int(np.argmin(distance))

    before, after = tip_path(readings, times[nearest] + TIME_STEP_S * np.array([-1, 1]))
    velocity = (after - before) / (2 * TIME_STEP_S)
    return HitResult(
        bool(hit),
        float(times[nearest]),
        float(distance[nearest]),
        len(contact_times),
        speed=float(np.linalg.norm(velocity)),
        direction=float(np.arctan2(velocity[1], velocity[0])),
        entered=bool(target.is_crossed_along(path).any()),
    )


def _contact_times(
    points: pd.DataFrame, obstacles: Sequence[Box], duration: float
) -> np.ndarray:
    """Find the times of frames in which the string lies in an obstacle [s]."""
    moving = points[points["t"].between(0, duration)].sort_values(["t", "s"])
    places, t = moving[["x", "y"]].to_numpy(), moving["t"].to_numpy()
    same_frame = t[1:] == t[:-1]
    touched = np.zeros(len(same_frame), dtype=bool)
    for box in obstacles:
        touched |= box.is_crossed_along(places) & same_frame
    return np.unique(t[1:][touched])


def tip_path(readings: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """Interpolate the tip by a cubic through the readings, and extrapolate it.

    Parameters
    ----------
    readings : table READINGS
        Tips of the frames.
    t : (K,) array
        Times [s].

    Returns
    -------
    (K, 2) array
        Positions [m]; NaN in gaps that are too long, or with fewer than two readings.
    """
    valid = readings[readings["valid"].astype(bool)]
    read_at = valid["t"].to_numpy()
    if len(read_at) < 2:
        return np.full((len(t), 2), np.nan)
    interval = np.searchsorted(read_at, t, side="right") - 1
    gap = np.diff(read_at)[np.clip(interval, 0, len(read_at) - 2)]
    # between neighbouring frames the path is always known
    frame_interval = float(np.median(np.diff(np.sort(readings["t"].to_numpy()))))
    longest = max(MAX_GAP_S, MAX_ROUNDED_INTERVAL * frame_interval)
    path = CubicSpline(read_at, valid[["tip_x", "tip_y"]])(t)
    return np.where((gap <= longest)[:, None], path, np.nan)


def check_reach(target: Box, arm: Arm, string_length: float) -> None:
    """Refuse a target that the outstretched arm and string cannot touch.

    Raises DataError. string_length: [m].
    """
    reach = arm.reach + string_length
    gap = target.distance_to(*arm.base)
    if gap > reach:
        base_x, base_y = arm.base
        raise DataError(
            f"target ({target.x * 1e3:.0f}, {target.y * 1e3:.0f}) mm",
            f"it is out of reach, {gap * 1e3:.0f} mm from the arm's base at "
            f"({base_x * 1e3:.0f}, {base_y * 1e3:.0f}) mm; arm and string reach "
            f"{reach * 1e3:.0f} mm",
            "The nearest target that they reach has its centre at "
            f"{_nearest_centre(target, arm, reach)}. Choose a closer target, or "
            "move arm.base.",
        )


def _nearest_centre(target: Box, arm: Arm, reach: float) -> str:
    """Return settings for the centre of the target, moved until it is in reach."""
    base = np.array(arm.base)
    way = target.centre - base
    # a millimetre less, because the settings are rounded
    x, y = base + way * (reach - 1e-3) / np.linalg.norm(way)
    return f"target.x={x:.3f} target.y={y:.3f}"
