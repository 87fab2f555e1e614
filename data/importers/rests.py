"""Trials of a session: recordings that go on while hand and string rest."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
from scipy import ndimage

from stringcast.data.artifacts import valid_rows
from stringcast.data.importers.pauses import part_name

STEP_S = 0.02  # of the times at which rests are found
MAX_SESSION_S = 6 * 3600.0
MIN_REST_S = 0.5
MIN_REST_STEPS = round(MIN_REST_S / STEP_S)
REST_SHARE = 0.02  # of the whole range, which coordinates do not exceed at rest
RANGE_QUANTILES = (0.005, 0.995)  # without outliers
# Longest rest that is kept before and after motions of hand and string. The offset of
# their clocks is known to some tenths of a second only.
HAND_LEAD_S, STRING_LEAD_S = 1.2, 0.5
# Longest time between beginnings of motion of hand and string: the string is slack, or
# its recording begins earlier
MAX_LAG_S = 0.6
MIN_MOTIONS = 3  # that show the offset of unknown clocks
LEVER_M = 0.3  # from the hand to a point that shows its direction


def join_session(
    motion: pd.DataFrame, points: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Join trials of one table that the other one recorded as a single trial.

    They have other names, follow one another, and are found again by the rests.
    """
    names, point_names = set(motion["trial"]), set(points["trial"])
    if names & point_names:
        return motion, points
    if len(names) == 1 and follow_one_another(points):
        joined = motion, points.assign(trial=names.pop())
    elif len(point_names) == 1 and follow_one_another(motion):
        joined = motion.assign(trial=point_names.pop()), points
    else:
        return motion, points
    return joined if len(split_session(*joined)) > 1 else (motion, points)


def follow_one_another(table: pd.DataFrame) -> bool:
    """Return whether no two trials of a table were recorded at the same time."""
    times = table.groupby("trial")["t"].agg(["min", "max"]).sort_values("min")
    return bool((times["min"].iloc[1:] > times["max"].iloc[:-1].to_numpy()).all())


def split_at_rests(
    motion: pd.DataFrame, points: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame, list[str]]:
    """Split each trial where hand and string rest together.

    A recording that pauses counts as rest. The clocks may differ: the beginnings of
    motions show by how much, and a trial remains whole if they do not. Returns both
    tables with new names of trials, and notes.
    """
    hand_parts = []
    string_parts = [points[~points["trial"].isin(motion["trial"])]]
    notes = []
    for name, hand_rows in motion.groupby("trial", sort=False):
        string_rows = points[points["trial"] == name]
        parts = split_session(hand_rows, string_rows)
        if len(parts) < 2:
            hand_parts.append(hand_rows)
            string_parts.append(string_rows)
            continue
        for number, (hand_part, string_part) in enumerate(parts):
            part = part_name(str(name), number)
            hand_parts.append(hand_part.assign(trial=part))
            string_parts.append(string_part.assign(trial=part))
        notes.append(
            f"hand and string rest between the motions of trial {name}, which is read "
            f"as {len(parts)} trials, without long rests"
        )
    motion = pd.concat(hand_parts, ignore_index=True)
    points = pd.concat(string_parts, ignore_index=True)
    return motion, points, notes


def split_session(
    motion: pd.DataFrame, points: pd.DataFrame
) -> list[tuple[pd.DataFrame, pd.DataFrame]]:
    """Split one trial into the rows of hand and string for each motion of the hand."""
    times = [table["t"][np.isfinite(table["t"])] for table in (motion, points)]
    durations = [np.ptp(t) if len(t) else 0.0 for t in times]
    if not MIN_REST_S < min(durations) <= max(durations) < MAX_SESSION_S:
        return []
    t, string_t = (np.arange(t.min(), t.max(), STEP_S) for t in times)
    hand_rests = find_rests_of_hand(motion, t)
    string_rests = find_rests_of_string(points, string_t)
    hand_begins = t[begins_motion(hand_rests)]
    string_begins = string_t[begins_motion(string_rests)]
    offset_s = offset_of_motions(hand_begins, string_begins)
    if offset_s is None:
        return []

    # The string's motion at the hand's times; it is unknown outside its recording
    index = np.rint((t - offset_s - string_t[0]) / STEP_S).astype(int)
    is_recorded = (index >= 0) & (index < len(string_t))
    string_moves = np.zeros(len(t), dtype=bool)
    string_moves[is_recorded] = ~string_rests[index[is_recorded]]

    hand_steps = (motion["t"] - t[0]) / STEP_S
    string_steps = (points["t"] + offset_s - t[0]) / STEP_S
    parts = []
    for before, after in pairwise(runs(hand_rests & ~string_moves)):
        between = slice(before.stop, after.start)
        if hand_rests[between].all() or not string_moves[between].any():
            continue
        begin = before.stop - kept_steps(before, HAND_LEAD_S)
        end = after.stop - kept_steps(after, HAND_LEAD_S)
        hand_part = motion[hand_steps.between(begin, end)]
        begin = before.stop - kept_steps(before, STRING_LEAD_S)
        end = after.start + kept_steps(after, STRING_LEAD_S)
        string_part = points[string_steps.between(begin, end)]
        parts.append((hand_part, string_part))
    return parts


def runs(is_resting: np.ndarray) -> list[slice]:
    """List the runs of rest (N,), with empty ones for motion at the ends."""
    edges = np.flatnonzero(np.diff(is_resting, prepend=False, append=False))
    found = [slice(begin, end) for begin, end in edges.reshape(-1, 2).tolist()]
    if not is_resting[0]:
        found.insert(0, slice(0, 0))
    if not is_resting[-1]:
        found.append(slice(len(is_resting), len(is_resting)))
    return found


def kept_steps(rest: slice, longest_s: float) -> int:
    """Return how much of a rest is kept next to a motion, in steps."""
    return min(round(longest_s / STEP_S), (rest.stop - rest.start) // 2)


def begins_motion(is_resting: np.ndarray) -> np.ndarray:
    """Return where motions begin, of rests (N,)."""
    return np.diff(is_resting.astype(int), prepend=1) < 0


def offset_of_motions(hand_t: np.ndarray, string_t: np.ndarray) -> float | None:
    """Return the offset of clocks at which most motions begin together [s].

    Clocks that agree are preferred. Returns None if few motions show an offset, or if
    another one is as good.

    hand_t, string_t: beginnings of the motions of the hand (M,) and the string (N,).
    """
    # Offsets of all pairs of motions, and how many pairs begin together at each
    offsets = np.sort(np.subtract.outer(hand_t, string_t), axis=None)
    first = np.searchsorted(offsets, offsets - MAX_LAG_S)
    last = np.searchsorted(offsets, offsets + MAX_LAG_S, side="right")
    counts = last - first
    most = counts.max(initial=0)
    if most < max(2, 0.5 * len(string_t)):
        return None
    best = offsets[counts == most]
    agreeing = best[np.abs(best) < MAX_LAG_S]
    if len(agreeing):
        return float(np.median(agreeing))
    if most < MIN_MOTIONS or np.ptp(best) > 2 * MAX_LAG_S:
        return None
    return float(np.median(best))


def find_rests_of_hand(motion: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """Return whether the hand rests or is not recorded at times (N,)."""
    places = motion.drop(columns=["trial", "t"])
    if "theta" in places:
        x, y, theta = places[["x", "y", "theta"]].to_numpy().T
        end = [x + LEVER_M * np.cos(theta), y + LEVER_M * np.sin(theta)]
        places = pd.DataFrame(np.stack([x, y, *end], axis=1), places.index)
    return find_rests(motion["t"], places, t)


def find_rests_of_string(points: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """Return whether all points of the string rest or are not seen at times (N,)."""
    points = valid_rows(points)
    rests = np.ones(len(t), dtype=bool)
    keys = [name for name in ("point", "s") if name in points]
    for _, rows in points.groupby(keys, dropna=False):
        rests &= find_rests(rows["t"], rows[["x", "y"]], t)
    return rests


def find_rests(
    measured_t: pd.Series, places: pd.DataFrame, t: np.ndarray
) -> np.ndarray:
    """Return whether places (K, C), measured at times (K,), rest at times (N,).

    Where nothing was measured they count as resting.
    """
    known = places[np.isfinite(measured_t)].assign(t=measured_t).dropna()
    known = known.sort_values("t")
    known_t = known.pop("t").to_numpy()
    if not len(known_t):
        return np.ones(len(t), dtype=bool)
    middles = 0.5 * (known_t[1:] + known_t[:-1])
    nearest = np.searchsorted(middles, t)
    at = known.to_numpy()[nearest]
    size = (MIN_REST_STEPS, 1)
    span = ndimage.maximum_filter(at, size) - ndimage.minimum_filter(at, size)
    low, high = known.quantile(RANGE_QUANTILES).to_numpy()
    is_quiet = span.max(axis=1) <= REST_SHARE * (high - low).max()
    rests = ndimage.binary_dilation(is_quiet, np.ones(MIN_REST_STEPS, dtype=bool))
    is_unknown = np.abs(known_t[nearest] - t) > 0.5 * MIN_REST_S
    return np.asarray(rests | is_unknown)
