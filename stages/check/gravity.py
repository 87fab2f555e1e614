"""Gravity, as a string's tip shows it: lengths in another unit, or times of slow
motion, make it another.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stringcast.stages.check.measured import CheckedTrial

# [s] over which a parabola is fitted: a tip that whips turns little in it
WINDOW_S = 0.04
MIN_FRAMES = 5  # frames of such a window
MIN_SAMPLES = 20  # windows of a trial
# rms sine of the string's end to the vertical: one that only hangs does not show how it
# falls
EXCLUDED_SHARE = 0.1
# of the tip's arc length: the piece beyond tells the direction of the string's end
FALL_QUANTILE = 0.75


def estimate_gravity(seen: CheckedTrial) -> float:
    """Gravity in the dataset's units of length and time; NaN where the trial does not
    tell it.

    Tension ends at the tip and pulls along the string: across it, what accelerates a
    limp string's tip is gravity alone. A stiff string is straightened too, and seems to
    fall up to several times as fast. Least squares over the frames of a trial, of the
    tip's acceleration across the string on that of gravity.
    """
    # where the tip was seen, and the string's direction there
    points = seen.points
    last = points[points["s"] > 0.95 * points["s"].max()].groupby("t").tail(1)
    t, tip = last["t"].to_numpy(), last[["x", "y"]].to_numpy()
    before = (
        points[points["s"] <= FALL_QUANTILE * points["s"].max()]
        .groupby("t")
        .tail(1)
        .set_index("t")
        .reindex(t)
    )
    hand = np.stack(
        [np.interp(t, seen.hand_t, seen.pose[:, axis]) for axis in (0, 1)], axis=-1
    )
    way = tip - np.where(np.isfinite(before[["x", "y"]]), before[["x", "y"]], hand)
    along = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)

    # parabolas through the tip, over windows of time
    size = (
        max(
            MIN_FRAMES,
            2 * int(WINDOW_S / max(float(np.median(np.diff(t))), 1e-9) / 2) + 1,
        )
        if len(t) > 1
        else 0
    )
    if len(t) < MIN_SAMPLES + size:
        return float("nan")
    windows = np.lib.stride_tricks.sliding_window_view
    times = windows(t, size) - t[size // 2 : len(t) - size // 2, None]
    parabola = np.linalg.pinv(
        np.stack([np.ones_like(times), times, times**2], axis=-1)
    )[:, 2]
    acceleration = 2 * np.einsum("fw,fcw->fc", parabola, windows(tip, size, axis=0))
    across = along[size // 2 : len(t) - size // 2, ::-1] * (-1.0, 1.0)
    falling, pulled = (acceleration * across).sum(axis=1), -across[:, 1]
    aside = float(np.mean(pulled**2))
    return (
        float(np.mean(falling * pulled) / aside)
        if aside > EXCLUDED_SHARE**2
        else float("nan")
    )


def median_gravity(trials: Iterable[CheckedTrial]) -> float:
    """The median of the trials that tell it; NaN where none does."""
    known = [g for seen in trials if np.isfinite(g := estimate_gravity(seen))]
    return float(np.median(known)) if known else float("nan")
