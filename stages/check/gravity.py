"""Estimate of gravity from the motion of a string's tip.

A wrong unit of length or times of slow motion change this estimate.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stringcast.stages.check.measured import CheckedTrial, drop_spikes
from stringcast.stages.common import GRAVITY_M_S2, NORMAL_95
from stringcast.stages.model.polyline import turn_left

# duration of a fitted parabola, in which a fast tip turns little
WINDOW_S = 0.04
MAX_WINDOW_RATIO = 1.5  # of a window's duration over that without lost frames
MIN_WINDOW_FRAMES = 5
MIN_WINDOWS = 20
# rms sine of the angle of the string's end to the vertical: a hanging string does not
# show gravity
MIN_SINE = 0.1
# relative arc length from which the piece to the tip gives the direction of the end
DIRECTION_FROM = 0.75
TIP_FROM = 0.95  # relative arc length from which a point is at the tip


def estimate_gravity(trial: CheckedTrial) -> float:
    """Estimate gravity in the dataset's units of length and time.

    Tension pulls the tip along the string. Across the string, the tip of a limp string
    is accelerated by gravity alone. A stiff string is also straightened, and seems to
    fall up to several times as fast. The estimate regresses the tip's acceleration
    across the string on that of gravity, over all frames. It is NaN if the trial does
    not show it.
    """
    t, tip, direction = _tip_track(trial)
    if len(t) < 2:
        return np.nan
    interval = max(float(np.median(np.diff(t))), 1e-9)
    frames_per_window = max(MIN_WINDOW_FRAMES, 2 * int(WINDOW_S / interval / 2) + 1)
    if len(t) < MIN_WINDOWS + frames_per_window:
        return np.nan

    # windows without lost frames, which would make them too long for a parabola
    times = sliding_window_view(t, frames_per_window)
    usual_duration = (frames_per_window - 1) * interval
    is_whole = np.ptp(times, axis=1) <= MAX_WINDOW_RATIO * usual_duration
    if is_whole.sum() < MIN_WINDOWS:
        return np.nan

    # acceleration in the middle of N windows of W frames
    middle = np.flatnonzero(is_whole) + frames_per_window // 2
    times = times[is_whole] - t[middle, None]  # (N, W)
    places = sliding_window_view(tip, frames_per_window, axis=0)[is_whole]  # (N, 2, W)
    acceleration = _parabola_accelerations(times, places)  # (N, 2)

    # components across the string, measured and by a gravity of 1, (N,)
    across = turn_left(direction[middle])
    measured = (acceleration * across).sum(axis=1)
    expected = -across[:, 1]
    if np.mean(expected**2) <= MIN_SINE**2:
        return np.nan

    # windows overlap: only every W-th is independent
    independent_count = max(len(middle) / frames_per_window, 1.0)
    gravity, sigma = _fit_through_origin(expected, measured, independent_count)
    if NORMAL_95 * sigma > max(abs(gravity), GRAVITY_M_S2):
        return np.nan
    return gravity


def _fit_through_origin(
    x: np.ndarray, y: np.ndarray, independent_count: float
) -> tuple[float, float]:
    """Fit the slope of y = slope x by least squares; return it and its sigma."""
    mean_square = float(np.mean(x**2))
    slope = float(np.mean(y * x) / mean_square)
    variance = float(np.mean((y - slope * x) ** 2))
    return slope, float(np.sqrt(variance / mean_square / independent_count))


def _tip_track(trial: CheckedTrial) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (F,) [s], the tip (F, 2) and the string's direction there (F, 2)."""
    points = trial.points
    end = points["s"].max()
    last = points[points["s"] > TIP_FROM * end].groupby("t").tail(1)
    t, tip = drop_spikes(last["t"].to_numpy(), last[["x", "y"]].to_numpy())
    inner = points[points["s"] <= DIRECTION_FROM * end].groupby("t").tail(1)
    before_tip = inner.set_index("t").reindex(t)[["x", "y"]]
    # if no point before the tip was seen, the hand replaces it
    start = np.where(np.isfinite(before_tip), before_tip, trial.hand_at(t))
    chord = tip - start
    lengths = np.linalg.norm(chord, axis=1, keepdims=True)
    return t, tip, chord / np.maximum(lengths, 1e-12)


def _parabola_accelerations(times: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Fit parabolas to windows (N, W) of times and (N, 2, W) of places, (N, 2).

    The acceleration is twice the coefficient of t^2, which is a weighted sum of places.
    """
    powers = np.stack([np.ones_like(times), times, times**2], axis=-1)  # (N, W, 3)
    weights = np.linalg.pinv(powers)[:, 2]  # (N, W)
    return 2 * np.einsum("nw,nxw->nx", weights, places)


def median_gravity(trials: Iterable[CheckedTrial]) -> float:
    """Return the median estimate over moving trials that show it; NaN if none does."""
    moving = [trial for trial in trials if trial.string_onset is not None]
    estimates = [estimate_gravity(trial) for trial in moving]
    known = [gravity for gravity in estimates if np.isfinite(gravity)]
    return float(np.median(known)) if known else np.nan
