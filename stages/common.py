"""Shared helpers of stages: progress, robust scatter, and tracks of places on a string."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Progress = Callable[[float], object]  # called with the share of a stage that is done
# standard deviation over median magnitude, of a normal distribution
MAD_TO_SIGMA = 1.4826
# [m] points of two frames so near along the string are of one place
PLACE_WIDTH_M = 1e-3
FULL_TRACK_SHARE = 0.9  # of the frames have no more points than a full one
# of the steps along a place's way that take as many frames as those before them, where
# places are fixed
REPEATED_SHARE = 0.3


@dataclass(frozen=True)
class SettingsGroup:
    """Settings that belong together: an argument of a stage's function whose fields are
    settings of the stage's block, side by side with its others.
    """


class InterruptRequest(KeyboardInterrupt):
    """Raised in a stage when whoever waits for it interrupts it: it may end with what
    it knows and say so, or let this pass.
    """


def partial_progress(progress: Progress, number: int, count: int) -> Progress:
    """The progress of one of so many parts that take as long as each other."""
    return lambda share: progress((number + share) / count)


def mad_sigma(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Robust standard deviation about zero, of all values (...) or along an axis, from
    their median magnitude.
    """
    return MAD_TO_SIGMA * np.asarray(np.median(np.abs(values), axis=axis), dtype=float)


def rms(values: np.ndarray) -> float:
    """Root mean square of values of any shape, in their unit; NaN of none."""
    return (
        float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else float("nan")
    )


def track_places(frame: np.ndarray, s: np.ndarray) -> list[np.ndarray]:
    """Indices of the points of each place, in the order of time, at most one a frame.

    frame: (N,) number of each point's frame, in order. s: (N,) its arc length [m], in
    order within a frame. Where points were measured at other places in every frame,
    places are as many as a full frame has points.
    """
    apart = np.diff(s)[np.diff(frame) == 0]  # of neighbours in a frame
    apart = apart[apart > 0]
    # of a place that is the same in all frames
    width = (
        min(PLACE_WIDTH_M, float(np.median(apart)) / 2) if apart.size else PLACE_WIDTH_M
    )
    fixed = _binned_tracks(frame, s, width)
    # in a full frame
    most = (
        int(np.quantile(np.unique(frame, return_counts=True)[1], FULL_TRACK_SHARE))
        if len(frame)
        else 0
    )
    # places that are fixed come again regularly
    gaps = [np.diff(frame[track]) for track in fixed]
    same = (
        np.concatenate([gap[1:] == gap[:-1] for gap in gaps])
        if gaps
        else np.zeros(0, bool)
    )
    if (
        most < 2
        or np.ptp(s) <= PLACE_WIDTH_M
        or (same.size > 0 and float(np.mean(same)) > REPEATED_SHARE)
    ):
        return fixed
    return _binned_tracks(frame, s, float(np.ptp(s)) / (most - 1))


def places_wander(s: np.ndarray, tracks: Sequence[np.ndarray]) -> bool:
    """Whether points are measured at other places in every frame. tracks: as `tracked`
    finds them.
    """
    return any(np.ptp(s[track]) > PLACE_WIDTH_M for track in tracks)


def points_at_arc_lengths(
    frame: np.ndarray, s: np.ndarray, points: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Positions (F, M, 2) [m] of arc lengths (M,) [m] in each frame, between its points
    (N, 2) [m]; NaN beyond its ends.
    """
    result = np.full((int(frame.max()) + 1, len(places), 2), np.nan)
    for number, line in enumerate(result):
        now = frame == number
        for axis in range(2):
            line[:, axis] = np.interp(
                places, s[now], points[now, axis], left=np.nan, right=np.nan
            )
    return result


def _binned_tracks(frame: np.ndarray, s: np.ndarray, width: float) -> list[np.ndarray]:
    """Tracks of places so wide [m]."""
    place = np.round(s / width).astype(int)
    tracks = [np.flatnonzero(place == value) for value in np.unique(place)]
    return [track[np.unique(frame[track], return_index=True)[1]] for track in tracks]
