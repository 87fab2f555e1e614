"""Estimate of gravity from the motion of a string's tip.

Lengths in another unit, or times of slow motion, change this estimate.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stringcast.stages.check.measured import CheckedTrial, drop_spikes
from stringcast.stages.common import GRAVITY_M_S2, NORMAL_95, turn_left

# a parabola is fitted over so long: a fast tip turns little in it
WINDOW_S = 0.04
MAX_WINDOW_RATIO = 1.5  # of a window's duration over that without lost frames
MIN_WINDOW_FRAMES = 5
MIN_WINDOWS = 20
# rms sine of the angle of the string's end to the vertical: a string that only hangs
# does not show how it falls
MIN_SINE = 0.1
# relative arc length: the piece from there to the tip gives the direction of the end
DIRECTION_FROM = 0.75
TIP_FROM = 0.95  # relative arc length from which a point counts as the tip


def estimate_gravity(trial: CheckedTrial) -> float:
    """Estimate gravity in the dataset's units of length and time.

    Tension ends at the tip and pulls along the string. Across the string, a limp
    string's tip is accelerated by gravity alone. A stiff string is straightened too,
    and seems to fall up to several times as fast. The estimate regresses the tip's
    acceleration across the string on that of gravity, over all frames.

    Parameters
    ----------
    trial
        A trial with points.

    Returns
    -------
    float
        Gravity, or NaN if the trial does not show it.
    """
    t, tip, direction = _tip_track(trial)
    if len(t) < 2:
        return float("nan")
    interval = max(float(np.median(np.diff(t))), 1e-9)
    size = max(MIN_WINDOW_FRAMES, 2 * int(WINDOW_S / interval / 2) + 1)
    if len(t) < MIN_WINDOWS + size:
        return float("nan")

    # accelerations in windows of `size` frames; none with lost frames, over which a
    # parabola says nothing of a moment
    times = sliding_window_view(t, size)
    is_whole = np.ptp(times, axis=1) <= MAX_WINDOW_RATIO * (size - 1) * interval
    if is_whole.sum() < MIN_WINDOWS:
        return float("nan")
    middle = np.flatnonzero(is_whole) + size // 2
    times = times[is_whole] - t[middle, None]
    places = sliding_window_view(tip, size, axis=0)[is_whole]  # (N, 2, size)
    acceleration = _parabola_accelerations(times, places)

    # their components across the string, and those of a gravity of 1, (N,)
    across = turn_left(direction[middle])
    measured = (acceleration * across).sum(axis=1)
    expected = -across[:, 1]

    # regression through the origin
    mean_square = float(np.mean(expected**2))
    if mean_square <= MIN_SINE**2:
        return float("nan")
    gravity = float(np.mean(measured * expected) / mean_square)
    variance = float(np.mean((measured - gravity * expected) ** 2))
    # windows overlap: only every size-th is independent
    independent = max(len(middle) / size, 1.0)
    error = float(np.sqrt(variance / mean_square / independent))
    if NORMAL_95 * error > max(abs(gravity), GRAVITY_M_S2):
        return float("nan")
    return gravity


def _tip_track(trial: CheckedTrial) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (F,) [s], the tip (F, 2) and the string's direction there (F, 2)."""
    points = trial.points
    end = points["s"].max()
    last = points[points["s"] > TIP_FROM * end].groupby("t").tail(1)
    t, tip = drop_spikes(last["t"].to_numpy(), last[["x", "y"]].to_numpy())
    inner = points[points["s"] <= DIRECTION_FROM * end].groupby("t").tail(1)
    before = inner.set_index("t").reindex(t)[["x", "y"]]
    chord = tip - np.where(np.isfinite(before), before, trial.hand_at(t))
    lengths = np.linalg.norm(chord, axis=1, keepdims=True)
    return t, tip, chord / np.maximum(lengths, 1e-12)


def _parabola_accelerations(times: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Fit parabolas to windows (N, W) of times and (N, 2, W) of places, (N, 2)."""
    powers = np.stack([np.ones_like(times), times, times**2], axis=-1)
    quadratic = np.linalg.pinv(powers)[:, 2]  # (N, W)
    return np.asarray(2 * np.einsum("fw,fcw->fc", quadratic, places))


def median_gravity(trials: Iterable[CheckedTrial]) -> float:
    """Return the median estimate of the trials that show it; NaN if none does."""
    estimates = [estimate_gravity(trial) for trial in trials]
    known = [gravity for gravity in estimates if np.isfinite(gravity)]
    return float(np.median(known)) if known else float("nan")
