"""A steady schedule fitted to the arrival times of frames.

A camera exposes at a steady rate. Arrivals have random delays, and some frames are
missing. The highest peak of the periodogram gives the rate, robustly against delays.
The quickest frames give the phase. A frame belongs to the last moment of exposure
before it. Of two frames with the same moment, the earlier one belongs to the moment
before.

References
----------
Bartlett, M. S. (1963). The spectral analysis of point processes. J. R. Stat. Soc. B 25,
264-296.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PERIOD_TOLERANCE = 0.05  # relative deviation from the nominal period
QUICK_PERCENTILE = 10  # of the lateness, taken as zero delay
# periods by which a frame may arrive before its due time
EARLY_PERIODS = 0.25


@dataclass(frozen=True)
class FrameSchedule:
    """The frames of a film on a steady schedule.

    Attributes
    ----------
    period
        Period of the schedule [s].
    numbers : (F,) int
        Number of each frame on the schedule, from 0.
    due : (F,)
        Arrival time of each frame without extra delay [s].
    lateness : (F,)
        Extra delay of each frame [s].
    """

    period: float
    numbers: np.ndarray
    due: np.ndarray
    lateness: np.ndarray

    def last_due_number(self, t: float) -> int:
        """Return the number of the last frame due at a time [s]."""
        elapsed = (t - self.due[0]) / self.period
        return int(np.floor(elapsed + 1e-6)) + int(self.numbers[0])


def fit_schedule(t: np.ndarray, period: float) -> FrameSchedule:
    """Fit a steady schedule to arrival times.

    Parameters
    ----------
    t : (F,)
        Sorted arrival times [s].
    period
        Nominal period [s].

    Returns
    -------
    FrameSchedule
        The schedule with the number and the lateness of each frame.
    """
    elapsed = t - t[0]
    rate, phase = _most_coherent_rate(elapsed, period)

    # number of the last exposure before each frame
    periods = elapsed * rate - phase / (2 * np.pi)  # near whole numbers
    late_periods = periods - np.rint(periods)
    quickest_periods = np.percentile(late_periods, QUICK_PERCENTILE)
    last_moment = np.floor(periods - quickest_periods + EARLY_PERIODS)
    numbers = _distinct_numbers(last_moment.astype(int))

    # schedule through the quickest frames [s]
    fitted_period = _fit_period(numbers, t, period)
    start = t - fitted_period * numbers  # time of frame 0 according to each frame
    quickest_start = np.percentile(start, QUICK_PERCENTILE)
    due = quickest_start + fitted_period * numbers
    return FrameSchedule(fitted_period, numbers, due, start - quickest_start)


def _most_coherent_rate(elapsed: np.ndarray, period: float) -> tuple[float, float]:
    """Find the rate near 1 / period [1/s] with the largest coherence.

    It is the highest peak of the periodogram |sum_k exp(2 pi i rate t_k)|^2 (Bartlett
    1963). Returns the rate and the phase of the sum [rad].
    """
    span_periods = elapsed[-1] / period + 1
    # eight steps per width of a peak
    steps = int(np.ceil(16 * PERIOD_TOLERANCE * span_periods))
    low, high = 1 - PERIOD_TOLERANCE, 1 + PERIOD_TOLERANCE
    rates = np.linspace(low, high, 2 * steps + 1) / period
    sums = np.array([np.exp(2j * np.pi * rate * elapsed).sum() for rate in rates])
    best = int(np.argmax(np.abs(sums)))
    return rates[best], np.angle(sums[best])


def _distinct_numbers(numbers: np.ndarray) -> np.ndarray:
    """Count frames from 0 without repetitions.

    Of two frames with one number, the earlier gets the number before, and so on.
    """
    indices = np.arange(len(numbers))
    # strictly increasing numbers minus indices never decrease
    excess = numbers - indices
    least_excess_behind = np.minimum.accumulate(excess[::-1])[::-1]
    distinct = least_excess_behind + indices
    return distinct - distinct[0]


def _fit_period(numbers: np.ndarray, t: np.ndarray, period: float) -> float:
    """Fit the period [s] by a line, then again to the quicker half of the frames.

    With fewer than two periods or too few quick frames it stays unchanged.
    """
    if numbers[-1] <= 1:
        return period
    fitted_period, start = map(float, np.polyfit(numbers, t, 1))
    late = t - fitted_period * numbers - start
    is_quick = late <= np.median(late)
    if len(np.unique(numbers[is_quick])) <= 2:
        return fitted_period
    return float(np.polyfit(numbers[is_quick], t[is_quick], 1)[0])
