"""The schedule behind the times of frames: which frame of a steady camera each one is,
and how late it came.

A camera exposes at a steady rate; what is noted of it is late, now a little, now a lot,
never early, and some frames are missing. The rate at which the times are most in step
(the highest peak of their periodogram, Bartlett 1963) is found whatever the lateness of
single frames, and however many are missing. The quickest frames then show the moments;
a frame belongs to the last one before it, and no two to the same: of two, the earlier
was late.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PERIOD_TOLERANCE = 0.05  # by which the true period may differ from the expected one
QUICK_PERCENTILE = 10  # percentile of the lateness that counts as in time
# periods by which a frame may come before the quickest ones show that it is due
EARLY_PERIODS = 0.25


@dataclass(frozen=True)
class FrameSchedule:
    """period [s]. numbers: (F,) int, from 0. due: (F,) times of the quickest frames
    [s]. late: (F,) [s].
    """

    period: float
    numbers: np.ndarray
    due: np.ndarray
    lateness: np.ndarray

    def last_due_number(self, t: float) -> int:
        """Number of the last frame due at a time [s]."""
        return int(np.floor((t - self.due[0]) / self.period + 1e-6)) + int(
            self.numbers[0]
        )


def fit_schedule(t: np.ndarray, period: float) -> FrameSchedule:
    """The schedule of frames noted at times t (F,) [s], sorted, with about this period
    [s].
    """
    # in turns of the rate near 1 / period with which the times are most in step, about
    # whole numbers
    since = t - t[0]
    # eight to the width of a peak
    steps = int(np.ceil(16 * PERIOD_TOLERANCE * (since[-1] / period + 1)))
    rates = (
        np.linspace(1 - PERIOD_TOLERANCE, 1 + PERIOD_TOLERANCE, 2 * steps + 1) / period
    )
    waves = np.array([np.exp(2j * np.pi * rate * since).sum() for rate in rates])
    best = int(np.argmax(np.abs(waves)))
    turns = since * rates[best] - np.angle(waves[best]) / (2 * np.pi)
    late = turns - np.rint(turns)
    numbers = np.floor(
        turns - np.percentile(late, QUICK_PERCENTILE) + EARLY_PERIODS
    ).astype(int)
    # no number twice: of two frames on one moment the earlier was late, and so are
    # those that it pushes
    places = np.arange(len(numbers))
    numbers = np.minimum.accumulate((numbers - places)[::-1])[::-1] + places
    numbers -= numbers[0]
    # seconds a number, from frames in time: twice a line, the second time without the
    # half that is latest
    slope = period
    if numbers[-1] > 1:
        slope, start = map(float, np.polyfit(numbers, t, 1))
        late = t - slope * numbers - start
        kept = late <= np.median(late)
        if len(np.unique(numbers[kept])) > 2:
            slope = float(np.polyfit(numbers[kept], t[kept], 1)[0])
    late = t - slope * numbers
    quickest = np.percentile(late, QUICK_PERCENTILE)
    return FrameSchedule(slope, numbers, quickest + slope * numbers, late - quickest)
