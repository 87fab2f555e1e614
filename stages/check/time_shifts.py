"""Estimate of the difference of two clocks.

Hand and string begin to move at about the same time, and a string never gets longer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.check.measured import CheckedTrial

# onsets of trials agree within this if their clocks differ by the same in all: the tip
# lags by so much at most
MAX_ONSET_SPREAD_S = 0.2
# a tip that hangs below the hand lags by sqrt(length / g)
SEARCH_HALF_WIDTH_S = 0.3
SHIFT_STEP_S = 1e-3
# a string may seem so much longer than at the best shift, relative to its length: 1 mm
# of noise on 0.3 m
LENGTH_TOLERANCE = 0.004


def estimate_time_shifts(trials: Sequence[CheckedTrial]) -> dict[str, float]:
    """Estimate the time to add to the points of each trial.

    The shift is the same for all trials if their onsets agree. It is the latest shift
    at which points stay about as near to the hand as their arc lengths demand. The
    string follows the hand, so onsets alone would give an early shift.

    Parameters
    ----------
    trials
        Trials with points.

    Returns
    -------
    dict
        Shifts by trial [s]; none for a trial without motion.
    """
    shifts: dict[str, float] = {}
    moving = []
    for trial in trials:
        if trial.hand_onset is not None and trial.string_onset is not None:
            shifts[trial.name] = trial.hand_onset - trial.string_onset
            moving.append(trial)
    if shifts and np.ptp(list(shifts.values())) < MAX_ONSET_SPREAD_S:
        return dict.fromkeys(shifts, _latest_shift(moving, max(shifts.values())))
    return {trial.name: _latest_shift([trial], shifts[trial.name]) for trial in moving}


def _latest_shift(trials: Sequence[CheckedTrial], start: float) -> float:
    """Return the latest shift near `start` that hardly stretches strings [s]."""
    candidates = start + np.arange(
        -SEARCH_HALF_WIDTH_S, SEARCH_HALF_WIDTH_S + SHIFT_STEP_S, SHIFT_STEP_S
    )
    # rms excess of distances from the hand over arc lengths, relative to the length
    excesses = []
    for trial in trials:
        s, x, y = trial.points[["s", "x", "y"]].to_numpy().T
        t = trial.points["t"].to_numpy() + candidates[:, None]
        hand_x, hand_y = trial.pose.T[:2]
        dx = x - np.interp(t, trial.hand_t, hand_x)
        dy = y - np.interp(t, trial.hand_t, hand_y)
        excess = np.maximum(np.hypot(dx, dy) - s, 0.0)
        excesses.append(np.sqrt(np.mean(excess**2, axis=1)) / trial.length)
    worst = np.max(excesses, axis=0)
    best = int(worst.argmin())
    is_stretched = worst[best:] > worst[best] + LENGTH_TOLERANCE
    if not is_stretched.any():
        return float(candidates[best])
    return float(candidates[best + int(np.argmax(is_stretched)) - 1])
