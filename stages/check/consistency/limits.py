"""Limits that hold for every string, stiffness and clock offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import combinations

import numpy as np

from stringcast.data.dataset import MAX_ARC_LENGTH_RATIO
from stringcast.stages.check.consistency.record import (
    MIN_OVERLAP,
    Measurements,
    Recording,
    Track,
)
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.polyline import step_lengths

# of a point's distance from the hand beyond its arc length, relative to the string's
MAX_GAP = 0.25
# of the points of a motion: the others may be outliers
GAP_QUANTILE = 0.8
MAX_STRETCH = 1.5  # of the distance between two points over their arc length
# of the tip's over any other point's distance from the grasp at rest: with less, the
# string would be bent by more than half a turn
MIN_TIP_DISTANCE = 0.95
PLAUSIBLE_LENGTHS_M = (0.01, 20.0)
MAX_HAND_SPEED = 40.0  # [m/s]
SPEED_QUANTILE = 0.95  # of the steps: the others may be outliers
INITIAL_FRAMES = 10  # in which wrong clocks matter least
OFFSET_COUNT = 81  # clock offsets that are tried


class Limit(Enum):
    """A bound that no string and no arm exceeds."""

    LENGTH = auto()  # of a string
    SPEED = auto()  # of a hand
    ARC_LENGTH = auto()  # of a point, beyond the string's end
    STRETCH = auto()  # between two points
    ORDER = auto()  # a tip that rests nearer to the hand than another point
    GAP = auto()  # between a point and the hand


@dataclass(frozen=True)
class BrokenLimit:
    """A limit that a trial breaks, with a statement."""

    limit: Limit
    statement: str


def broken_limits(measured: Measurements) -> dict[str, BrokenLimit]:
    """Return the limit that each impossible trial breaks, by trial."""
    broken = {}
    for recording in measured.recordings:
        limit = broken_limit(measured, recording)
        if limit is not None:
            broken[recording.name] = limit
    return broken


def is_impossible(measured: Measurements) -> bool:
    """Return whether any trial breaks a limit; others are not computed then."""
    trials = measured.recordings
    return any(broken_limit(measured, recording) is not None for recording in trials)


def broken_limit(measured: Measurements, recording: Recording) -> BrokenLimit | None:
    """Return the limit that a trial breaks; None if it is possible."""
    length = measured.length
    low, high = PLAUSIBLE_LENGTHS_M
    if length is not None and not low <= length <= high:
        return BrokenLimit(Limit.LENGTH, f"no string is {length:.4g} m long")
    pose = measured.pose(recording)
    speed = hand_speed(recording.t, pose)
    if speed > MAX_HAND_SPEED:
        return BrokenLimit(Limit.SPEED, f"the hand would move with {speed:.3g} m/s")
    known = [track for track in recording.tracks if track.s is not None]
    limit = (
        broken_arc_length(known, length)
        or broken_stretch(known)
        or broken_order(recording, pose[0, :2])
    )
    if limit is not None:
        return limit
    for track in recording.tracks:
        s = length if track.s is None else track.s
        if s is None:
            continue
        gap = reach_excess(recording, pose, track, s)
        if gap > MAX_GAP * (length or s):
            statement = (
                f"the point at s = {s:.4g} m would be {s + gap:.3g} m from the grasp"
            )
            return BrokenLimit(Limit.GAP, statement)
    return None


def broken_arc_length(
    tracks: Sequence[Track], length: float | None
) -> BrokenLimit | None:
    """Return the limit that a point beyond the string's end breaks, or None."""
    for track in tracks:
        if length and track.s and track.s > MAX_ARC_LENGTH_RATIO * length:
            statement = f"s goes up to {track.s:.4g} m on a string of {length:.4g} m"
            return BrokenLimit(Limit.ARC_LENGTH, statement)
    return None


def broken_stretch(tracks: Sequence[Track]) -> BrokenLimit | None:
    """Return the limit that two points too far apart break, or None."""
    for first, second in combinations(tracks, 2):
        ratio = stretch(first, second)
        if ratio > MAX_STRETCH:
            statement = (
                f"the points at s = {first.s:.4g} and {second.s:.4g} m are {ratio:.3g} "
                "times as far apart as their arc lengths"
            )
            return BrokenLimit(Limit.STRETCH, statement)
    return None


def broken_order(recording: Recording, hand: np.ndarray) -> BrokenLimit | None:
    """Return the limit that a tip in the middle of the string breaks, or None.

    Only points without stated arc length are checked; the tip is recognised by its
    name. hand: place at rest, (2,) [m].
    """
    tip = recording.track("tip")
    if tip is None or tip.s is not None or recording.starts_moving:
        return None
    tip_m = float(np.linalg.norm(tip.rest_place - hand))
    for track in recording.tracks:
        distance_m = float(np.linalg.norm(track.rest_place - hand))
        if tip_m < MIN_TIP_DISTANCE * distance_m:
            statement = (
                f"the tip would rest {tip_m:.3g} m from the grasp, and the point "
                f"'{track.point}' {distance_m:.3g} m"
            )
            return BrokenLimit(Limit.ORDER, statement)
    return None


def hand_speed(t: np.ndarray, pose: np.ndarray) -> float:
    """Return a high quantile of the hand's speed [m/s]."""
    dt = np.diff(t)
    is_step = dt > 0
    speeds = step_lengths(pose[:, :2])[is_step] / dt[is_step]
    moving = speeds[speeds > 0]
    return float(np.quantile(moving, SPEED_QUANTILE)) if len(moving) else 0.0


def stretch(first: Track, second: Track) -> float:
    """Return median distance over arc length of two points; 1 if it is unknown."""
    assert first.s is not None
    assert second.s is not None
    span = abs(second.s - first.s)
    _, a, b = np.intersect1d(first.t, second.t, return_indices=True)
    if not len(a) or span < 1e-9:
        return 1.0
    distance = np.linalg.norm(first.xy[a] - second.xy[b], axis=1)
    return float(np.median(distance) / span)


def reach_excess(
    recording: Recording, pose: np.ndarray, track: Track, s: float
) -> float:
    """Return a point's distance from the hand beyond its arc length [m].

    If the string begins at rest, the first frames are used, with the hand at the same
    time or at the start of its log. Their median is robust against outliers. Otherwise
    all frames are used, with the best offset of the clocks.
    """
    if not len(track.t):
        return 0.0
    if not recording.starts_moving:
        begin, xy = track.t[:INITIAL_FRAMES], track.xy[:INITIAL_FRAMES]
        at_own_time = interpolate_rows(begin, recording.t, pose[:, :2])
        excesses = []
        for hand in (at_own_time, pose[:1, :2]):
            distance = np.linalg.norm(xy - hand, axis=1)
            excesses.append(float(np.median(distance)) - s)
        return min(excesses)

    excesses = []
    for offset in possible_offsets(recording.t, track.t):
        hand = interpolate_rows(track.t + offset, recording.t, pose[:, :2])
        distance = np.linalg.norm(track.xy - hand, axis=1)
        excesses.append(float(np.quantile(distance, GAP_QUANTILE)) - s)
    return min(excesses)


def possible_offsets(hand_t: np.ndarray, point_t: np.ndarray) -> np.ndarray:
    """Return clock offsets [s] at which two logs share most of the shorter one."""
    shorter = min(np.ptp(hand_t), np.ptp(point_t))
    low = hand_t[0] - point_t[-1] + MIN_OVERLAP * shorter
    high = hand_t[-1] - point_t[0] - MIN_OVERLAP * shorter
    return np.append(np.linspace(low, high, OFFSET_COUNT), np.clip(0.0, low, high))
