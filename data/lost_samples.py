"""Samples written by a tracker or a log without a measurement.

A tracker that loses a point repeats its last position exactly, or writes a fixed one
such as (0, 0). A log with a second publisher has rows of zeros.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

MIN_TRACK_SAMPLES = 8  # shorter tracks are not tested
# A slow quantised point moves by single steps of its grid. A held point jumps when it
# is detected again: by at least so many grid steps, and by so much of the extent of all
# points. Smaller jumps are harmless.
MIN_JUMP_STEPS = 3.0
MIN_JUMP_EXTENT = 3e-3
# By chance, noise repeats a quantised value and then jumps so far in at most 1.3 % of
# the steps; four repetitions in a row occur once in 1e5.
MIN_HELD_SHARE = 0.03
MIN_HELD_REPEATS = 4
# distance of a fixed position from the track, in extents, and its visits
MIN_AWAY_EXTENT = 0.1
MIN_RECURRENCES = 3
FAR_EXTENT = 3.0  # distance in extents of the other samples, for which one run suffices
MAX_FIXED_POSITIONS = 3  # the most frequent ones are tested
MIN_AWAY_SHARE = 0.8  # share of visits that begin and end with a jump
# jump to zero: smallest size [rad] or [m], and ratio to the median step
MIN_ZERO_JUMP = 0.05
ZERO_JUMP_RATIO = 10.0


@dataclass(frozen=True)
class LostSamples:
    """Samples of one trial without a measurement.

    kind: what was written instead. count: how many of `total` samples. longest:
    duration of the longest run [s].
    """

    trial: str
    kind: str
    count: int
    total: int
    longest: float


def find_lost_points(points: pd.DataFrame) -> tuple[pd.Series, list[LostSamples]]:
    """Find points that a tracker held or replaced by a fixed position.

    points: columns trial, t [s], s, x, y, in the order of trial and time. Returns True
    for each lost point, by the index of `points`, and the counts by trial and kind.
    """
    kinds = pd.Series("", index=points.index)  # empty for measured points
    found = []
    for trial, rows in points.groupby("trial", sort=False):
        longest: dict[str, float] = {}
        extent = track_extent(rows[["x", "y"]].to_numpy())
        for s, track in rows.groupby("s"):
            # The grasp is often computed from joints, which repeat when they stop
            if s == 0 or len(track) < MIN_TRACK_SAMPLES:
                continue
            xy = track[["x", "y"]].to_numpy()
            is_fixed, place = fixed_position_mask(xy)
            is_held = np.zeros(len(xy), dtype=bool)
            is_held[~is_fixed] = held_mask(xy[~is_fixed], extent)
            for kind, mask in ((place, is_fixed), ("its last position", is_held)):
                if mask.any():
                    kinds[track.index[mask]] = kind
                    duration = _longest_run(track["t"].to_numpy(), mask)
                    longest[kind] = max(longest.get(kind, 0.0), duration)
        for kind, duration in longest.items():
            count = int((kinds[rows.index] == kind).sum())
            found.append(LostSamples(str(trial), kind, count, len(rows), duration))
    return kinds != "", found


def held_mask(xy: np.ndarray, extent: float) -> np.ndarray:
    """Find samples (K, 2) that repeat the previous one while the point moves.

    Returns (K,) bool. Quantised points at rest also repeat, but do not jump afterwards.
    extent: size of the region in which the string moved.
    """
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    if len(xy) < MIN_TRACK_SAMPLES or not steps.any():
        return np.zeros(len(xy), dtype=bool)
    grid_step = float(steps[steps > 0].min())
    limit = max(MIN_JUMP_STEPS * grid_step, MIN_JUMP_EXTENT * extent)
    is_repeated = np.concatenate([[False], steps == 0])
    is_held = np.zeros(len(xy), dtype=bool)
    is_held_long = np.zeros(len(xy), dtype=bool)
    for first, last in find_runs(is_repeated):
        if _jumps_when_seen_again(xy, first, last, limit):
            run = slice(first, last + 1)
            is_held[run] = True
            is_held_long[run] = last - first + 1 >= MIN_HELD_REPEATS
    # a few short repetitions come from noise
    return is_held if is_held.mean() > MIN_HELD_SHARE else is_held_long


def _jumps_when_seen_again(xy: np.ndarray, first: int, last: int, limit: float) -> bool:
    """Return whether a point was elsewhere before a run of repetitions, and after it.

    The median of three samples is robust to an outlier. A point that stops or starts
    moves slowly on that side. A long run may end the track.
    """
    place = xy[last]
    jump_to = _distance_to_median(xy[max(first - 4, 0) : first - 1], place)
    jump_from = _distance_to_median(xy[last + 1 : last + 4], place)
    ends_track = last + 1 == len(xy) and last - first + 1 >= MIN_HELD_REPEATS
    return jump_to > limit and (jump_from > limit or ends_track)


def fixed_position_mask(xy: np.ndarray) -> tuple[np.ndarray, str]:
    """Find samples (K, 2) at one position to which the point jumps repeatedly.

    Returns a mask (K,), and the position, such as `(0, 0)`.
    """
    nothing = np.zeros(len(xy), dtype=bool), ""
    if len(xy) < MIN_TRACK_SAMPLES:
        return nothing
    limit = MIN_AWAY_EXTENT * track_extent(xy)
    if limit == 0:
        return nothing

    # repeated positions and (0, 0): the farthest, then the most frequent; complex
    # numbers x + iy are sorted in a quarter of the time of rows (x, y)
    positions, number, counts = np.unique(
        xy[:, 0] + 1j * xy[:, 1], return_inverse=True, return_counts=True
    )
    repeated = np.flatnonzero((positions == 0) | (counts > 1))
    if not len(repeated):
        return nothing
    centre = complex(*np.median(xy, axis=0))
    distances = np.abs(positions[repeated] - centre)
    farthest = repeated[np.argmax(distances)]
    by_frequency = repeated[np.argsort(-counts[repeated])]

    # a tracker writes the same position for all lost points
    for candidate in [farthest, *by_frequency[:MAX_FIXED_POSITIONS]]:
        mask = number == candidate
        if mask.all():
            continue
        visits = find_runs(mask)
        must_return = positions[candidate] != 0 and not _is_far(xy, mask)
        if must_return and len(visits) < MIN_RECURRENCES:
            continue
        away_count = 0
        for first, last in visits:
            away_count += _is_away(xy, first, last, limit, must_return)
        if away_count >= MIN_AWAY_SHARE * len(visits):
            place = positions[candidate]
            return mask, f"({place.real:.4g}, {place.imag:.4g})"
    return nothing


def _is_far(xy: np.ndarray, mask: np.ndarray) -> bool:
    """Return whether one position, where a mask is true, is far from all others."""
    others = xy[~mask]
    distance = np.linalg.norm(xy[mask][0] - np.median(others, axis=0))
    return bool(distance > FAR_EXTENT * track_extent(others))


def zero_row_mask(values: np.ndarray) -> np.ndarray:
    """Find rows of a log (K, J) that are zero while the hand is elsewhere, (K,) bool.

    There is a jump before and after such a row; a real hand reaches its zero pose in
    small steps.
    """
    mask = np.zeros(len(values), dtype=bool)
    is_zero = (values == 0).all(axis=1)
    if not is_zero.any() or is_zero.all():
        return mask
    steps = np.abs(np.diff(values, axis=0)).max(axis=1)
    measured_steps = steps[~is_zero[1:] & ~is_zero[:-1]]
    usual_step = float(np.median(measured_steps)) if len(measured_steps) else 0.0
    limit = max(MIN_ZERO_JUMP, ZERO_JUMP_RATIO * usual_step)
    for first, last in find_runs(is_zero):
        step_to = steps[first - 1] if first > 0 else np.inf
        step_from = steps[last] if last < len(steps) else np.inf
        mask[first : last + 1] = min(step_to, step_from) > limit
    return mask


def _distance_to_median(xy: np.ndarray, place: np.ndarray) -> float:
    """Return the distance of a position from the median of samples; 0 without any."""
    return float(np.linalg.norm(np.median(xy, axis=0) - place)) if len(xy) else 0.0


def _is_away(
    xy: np.ndarray, first: int, last: int, limit: float, must_return: bool
) -> bool:
    """Return whether a run of samples is far from the samples around it.

    must_return: whether the track must continue near its position before.
    """
    neighbours = np.concatenate(
        [xy[max(first - 1, 0) : first], xy[last + 1 : last + 2]]
    )
    jumps = neighbours - xy[first]  # (2, 2), or (1, 2) at an end of the track
    shortest = np.linalg.norm(jumps, axis=1).min()
    if not must_return:
        return bool(shortest > limit)
    change = np.linalg.norm(jumps[0] - jumps[-1])
    return bool(shortest > limit and change < 0.5 * shortest)


def track_extent(xy: np.ndarray) -> float:
    """Return the size of the region with 90 % of the coordinates."""
    low, high = np.quantile(xy, [0.05, 0.95], axis=0)
    return float(np.linalg.norm(high - low))


def find_runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.pad(mask.astype(int), 1)))
    return list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))


def _longest_run(t: np.ndarray, mask: np.ndarray) -> float:
    """Return the longest time between the samples around a run [s]."""
    longest = 0.0
    for first, last in find_runs(mask):
        start = t[max(first - 1, 0)]
        end = t[min(last + 1, len(t) - 1)]
        longest = max(longest, float(end - start))
    return longest
