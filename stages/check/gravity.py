"""Estimate of gravity from the motion of a string's tip.

Lengths in another unit, or times of slow motion, change this estimate.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stringcast.stages.check.measured import GRAVITY, CheckedTrial, drop_spikes

# a parabola is fitted over so long: a fast tip turns little in it
WINDOW_S = 0.04
MAX_WINDOW_RATIO = 1.5  # of a window's duration over that without lost frames
MIN_WINDOW_FRAMES = 5
MIN_WINDOWS = 20
# rms sine of the angle of the string's end to the vertical: a string that only hangs
# does not show how it falls
MIN_SINE = 0.1
NORMAL_95 = 1.96
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
    # the tip, and the string's direction there
    points = trial.points
    end = points["s"].max()
    last = points[points["s"] > TIP_FROM * end].groupby("t").tail(1)
    t, tip = drop_spikes(last["t"].to_numpy(), last[["x", "y"]].to_numpy())
    inner = points[points["s"] <= DIRECTION_FROM * end].groupby("t").tail(1)
    before = inner.set_index("t").reindex(t)[["x", "y"]]
    hand_xy = [np.interp(t, trial.hand_t, trial.pose[:, axis]) for axis in (0, 1)]
    chord = tip - np.where(np.isfinite(before), before, np.stack(hand_xy, axis=-1))
    lengths = np.linalg.norm(chord, axis=1, keepdims=True)
    direction = chord / np.maximum(lengths, 1e-12)  # (F, 2)

    # parabolas through the tip, over windows of time
    if len(t) < 2:
        return float("nan")
    interval = max(float(np.median(np.diff(t))), 1e-9)
    size = max(MIN_WINDOW_FRAMES, 2 * int(WINDOW_S / interval / 2) + 1)
    if len(t) < MIN_WINDOWS + size:
        return float("nan")
    windows = np.lib.stride_tricks.sliding_window_view
    middle = slice(size // 2, len(t) - size // 2)
    times = windows(t, size) - t[middle, None]
    powers = np.stack([np.ones_like(times), times, times**2], axis=-1)
    parabola = np.linalg.pinv(powers)[:, 2]
    acceleration = 2 * np.einsum("fw,fcw->fc", parabola, windows(tip, size, axis=0))

    across = direction[middle, ::-1] * (-1.0, 1.0)
    tip_across, gravity_across = (acceleration * across).sum(axis=1), -across[:, 1]
    # a parabola over lost frames says nothing of a moment
    is_whole = np.ptp(times, axis=1) <= MAX_WINDOW_RATIO * (size - 1) * interval
    if is_whole.sum() < MIN_WINDOWS:
        return float("nan")
    tip_across, gravity_across = tip_across[is_whole], gravity_across[is_whole]
    mean_square = float(np.mean(gravity_across**2))
    if mean_square <= MIN_SINE**2:
        return float("nan")
    gravity = float(np.mean(tip_across * gravity_across) / mean_square)
    # windows overlap: only every size-th is independent
    residual_mean_square = float(np.mean((tip_across - gravity * gravity_across) ** 2))
    independent = max(is_whole.sum() / size, 1.0)
    error = float(np.sqrt(residual_mean_square / mean_square / independent))
    if NORMAL_95 * error > max(abs(gravity), GRAVITY):
        return float("nan")
    return gravity


def median_gravity(trials: Iterable[CheckedTrial]) -> float:
    """Return the median estimate of the trials that show it; NaN if none does."""
    estimates = [estimate_gravity(trial) for trial in trials]
    known = [gravity for gravity in estimates if np.isfinite(gravity)]
    return float(np.median(known)) if known else float("nan")
