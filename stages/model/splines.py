"""Cubic splines through the samples of a motion.

SciPy has them, too, but takes 0.7 s to import.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.model.engine.threads import compile_kernel


def natural_rates(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Compute the rates of the natural cubic spline at its samples.

    Its curvature is continuous, and zero at both ends.

    Parameters
    ----------
    t : ndarray of shape (K,)
        Increasing times, two at least [s].
    values : ndarray of shape (B, K, ...)
        Samples.
    """
    by_time = np.moveaxis(values, 1, 0)
    columns = np.ascontiguousarray(by_time, dtype=float).reshape(len(t), -1)
    rates = np.empty_like(columns)
    _solve_rates(np.ascontiguousarray(t, dtype=float), columns, rates)
    return np.moveaxis(rates.reshape(by_time.shape), 0, 1)


@compile_kernel
def _solve_rates(t: np.ndarray, values: np.ndarray, rates: np.ndarray) -> None:
    """Fill the rates (K, M) of values (K, M): a tridiagonal system.

    Each is eliminated from the next equation, and then found from the last one back.
    """
    last = len(t) - 1
    following = np.empty(last)  # weight of the next rate in each equation
    following[0] = 0.5
    rates[0] = 1.5 * (values[1] - values[0]) / (t[1] - t[0])
    for k in range(1, last):
        before = 1 / (t[k] - t[k - 1])
        after = 1 / (t[k + 1] - t[k])
        pivot = 2 * (before + after) - before * following[k - 1]
        following[k] = after / pivot
        rises = before**2 * (values[k] - values[k - 1])
        rises += after**2 * (values[k + 1] - values[k])
        rates[k] = (3 * rises - before * rates[k - 1]) / pivot
    rise = (values[last] - values[last - 1]) / (t[last] - t[last - 1])
    rates[last] = (3 * rise - rates[last - 1]) / (2 - following[last - 1])
    for k in range(last - 1, -1, -1):
        rates[k] -= following[k] * rates[k + 1]


def interpolate_cubic(
    share: np.ndarray,
    values: tuple[np.ndarray, np.ndarray],
    rates: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate between the start and the end of intervals by cubics.

    Parameters
    ----------
    share : ndarray
        Time since the start, as a share of the interval.
    values, rates : tuple of ndarray
        At start and end. The interval is the unit of time of the rates.

    Returns
    -------
    values, rates : ndarray
        At this time.
    """
    start, end = rates
    rise = values[1] - values[0]
    cubic = start + end - 2 * rise
    square = 3 * rise - 2 * start - end
    value = ((cubic * share + square) * share + start) * share + values[0]
    return value, (3 * cubic * share + 2 * square) * share + start
