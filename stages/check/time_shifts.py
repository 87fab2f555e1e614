"""By how much two clocks differ, where nobody says: hand and string begin to move at
about the same time, and a string is never longer than it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.check.measured import CheckedTrial

SHIFT_SPREAD_S = (
    # [s] within which trials' onsets agree if their clocks differ by the same in all:
    # the tip is so late at most
    0.2
)
# [s] about the onset in which clocks are sought: a tip that hangs sqrt(length / g)
# below follows so late
SEARCH_HALF_WIDTH_S = 0.3
SHIFT_STEP_S = 1e-3  # [s]
LENGTH_SLACK = (
    # of the length by which a string may seem longer at another shift than at the best:
    # 1 mm of noise on 0.3 m
    0.004
)


def estimate_time_shifts(trials: Sequence[CheckedTrial]) -> dict[str, float]:
    """Time shifts to be added to each trial's points [s], by trial; none for a trial
    without motion.

    The same for all trials where their onsets agree. The latest shift is taken at which
    points stay about as near to the hand as their arc lengths demand: the string
    follows the hand, so that by the onsets alone it would be early.
    """
    onsets = {
        seen.name: seen.hand_onset - seen.string_onset
        for seen in trials
        if seen.hand_onset is not None and seen.string_onset is not None
    }
    moved = [seen for seen in trials if seen.name in onsets]
    if onsets and np.ptp(list(onsets.values())) < SHIFT_SPREAD_S:
        return dict.fromkeys(onsets, _latest_shift(moved, max(onsets.values())))
    return {seen.name: _latest_shift([seen], onsets[seen.name]) for seen in moved}


def _latest_shift(trials: Sequence[CheckedTrial], about: float) -> float:
    """The latest shift near `about` [s] at which these strings are hardly longer than
    at the best.
    """
    tried = about + np.arange(
        -SEARCH_HALF_WIDTH_S, SEARCH_HALF_WIDTH_S + SHIFT_STEP_S, SHIFT_STEP_S
    )
    # excess of points' distance from the hand over their arc lengths, in lengths of the
    # string (rms)
    stretched = []
    for seen in trials:
        s, *place = seen.points[["s", "x", "y"]].to_numpy().T
        t = seen.points["t"].to_numpy() + tried[:, None]
        off = [
            at - np.interp(t, seen.hand_t, hand)
            for at, hand in zip(place, seen.pose.T[:2], strict=True)
        ]
        stretched.append(
            np.sqrt(np.mean(np.maximum(np.hypot(*off) - s, 0.0) ** 2, axis=1))
            / seen.length
        )
    excess = np.max(stretched, axis=0)
    best = int(excess.argmin())
    bad = excess[best:] > excess[best] + LENGTH_SLACK
    return float(tried[best + int(np.argmax(bad)) - 1] if bad.any() else tried[best])
