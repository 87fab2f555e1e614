"""Places along the string at which points were measured, through the frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# points of two frames that lie so close along the string belong to one place
PLACE_WIDTH_M = 1e-3
FULL_FRAME_QUANTILE = 0.9  # of the frames' numbers of points
# share of a place's steps that span as many frames as the step before, from which
# places are taken to be fixed
REPEATED_SHARE = 0.3


def track_places(frame: np.ndarray, s: np.ndarray) -> list[np.ndarray]:
    """Track places on the string through the frames.

    Where points were measured at other places in every frame, there are as many places
    as a full frame has points.

    Parameters
    ----------
    frame : (N,) array of int
        Number of each point's frame, in order.
    s : (N,) array
        Arc length of each point [m], in order within a frame.

    Returns
    -------
    list of arrays of int
        Numbers of the points of each place in the order of time, at most one a frame.
    """
    spacing = np.diff(s)[np.diff(frame) == 0]
    spacing = spacing[spacing > 0]
    width = PLACE_WIDTH_M
    if spacing.size:
        width = min(width, float(np.median(spacing)) / 2)
    fixed = _binned_tracks(frame, s, width)

    # fixed places recur at regular intervals
    regular: list[bool] = []
    for track in fixed:
        interval = np.diff(frame[track])
        regular.extend(interval[1:] == interval[:-1])
    if regular and np.mean(regular) > REPEATED_SHARE:
        return fixed
    point_counts = np.unique(frame, return_counts=True)[1]
    if not len(point_counts) or np.ptp(s) <= PLACE_WIDTH_M:
        return fixed
    full_count = int(np.quantile(point_counts, FULL_FRAME_QUANTILE))
    if full_count < 2:
        return fixed
    return _binned_tracks(frame, s, float(np.ptp(s)) / (full_count - 1))


def places_wander(s: np.ndarray, tracks: Sequence[np.ndarray]) -> bool:
    """Decide whether points were measured at other places in every frame.

    s: (N,) arc lengths [m]. tracks: from `track_places`.
    """
    return any(np.ptp(s[track]) > PLACE_WIDTH_M for track in tracks)


def points_at_arc_lengths(
    frame: np.ndarray, s: np.ndarray, points: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Interpolate each frame's points at given arc lengths.

    Parameters
    ----------
    frame : (N,) array of int
        Number of each point's frame.
    s : (N,) array
        Arc length of each point [m].
    points : (N, 2) array
        Positions [m].
    places : (M,) array
        Arc lengths at which positions are wanted [m].

    Returns
    -------
    (F, M, 2) array
        Positions in each frame [m]; NaN beyond its outermost points.
    """
    order = np.argsort(frame, kind="stable")
    ends = np.cumsum(np.bincount(frame))[:-1]
    points_by_frame = np.split(order, ends)
    result = np.full((len(points_by_frame), len(places), 2), np.nan)
    for line, in_frame in zip(result, points_by_frame, strict=True):
        for axis in range(2):
            coordinate = points[in_frame, axis]
            line[:, axis] = np.interp(
                places, s[in_frame], coordinate, left=np.nan, right=np.nan
            )
    return result


def tracks_at_arc_lengths(
    times: np.ndarray,
    frame: np.ndarray,
    s: np.ndarray,
    points: np.ndarray,
    places: np.ndarray,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return times [s] and positions [m] of each place in the frames that show it.

    times: of the frames (F,). Other parameters are those of `points_at_arc_lengths`.
    """
    lines = points_at_arc_lengths(frame, s, points, places)  # (F, M, 2)
    tracks = []
    for line in np.moveaxis(lines, 1, 0):
        is_seen = np.isfinite(line[:, 0])
        tracks.append((times[is_seen], line[is_seen]))
    return tracks


def _binned_tracks(frame: np.ndarray, s: np.ndarray, width: float) -> list[np.ndarray]:
    """Tracks of places of this width [m]."""
    bins = np.round(s / width).astype(int)
    tracks = []
    for value in np.unique(bins):
        points = np.flatnonzero(bins == value)
        _, first_in_frame = np.unique(frame[points], return_index=True)
        tracks.append(points[first_in_frame])
    return tracks
