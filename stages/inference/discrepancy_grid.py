"""The grid of onsets and scales of a trial's discrepancy.

A model may fit a trial until something unknown begins, such as a gust or a touch. So a
discrepancy has an onset. Before it, the discrepancy is reduced to a hundredth, and
points have nearly the weight that they have without one. Its scale s [m] is its root
mean square at the tip over the trial.

A **grid point** is an onset and a scale. Its index counts all scales of the first onset
first.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

# Scales s, with a ratio of 1.56; the largest exceeds any misfit
DISCREPANCY_SCALES_M = np.concatenate([[0.0], np.geomspace(5e-5, 2.0, 25)])
MEDIAN_SCALE_M = 5e-4  # of the half-Cauchy prior of s
# Equally likely onsets, as shares of the trial's duration
ONSET_SHARES = np.arange(6) / 6
SHARE_BEFORE_ONSET = 0.01  # factor of the discrepancy before its onset


def onset_times(times: np.ndarray) -> np.ndarray:
    """Place the onsets in a trial with frames at times (F,), (W,) [s]."""
    return np.asarray(times[0] + ONSET_SHARES * (times[-1] - times[0]))


def sizes_by_onset(times: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """Compute the relative size of a discrepancy at each frame for each onset, (W, F).

    Parameters
    ----------
    times : numpy.ndarray, shape (F,)
        Frame times [s].
    growth : numpy.ndarray, shape (F,)
        Relative size of a discrepancy that begins with the trial.
    """
    has_begun = times >= onset_times(times)[:, None]
    return np.where(has_begun, growth, SHARE_BEFORE_ONSET * growth)


def split_grid_point(grid_point: int) -> tuple[int, int]:
    """Look up the indices of the onset and of the scale of a grid point."""
    return divmod(int(grid_point), len(DISCREPANCY_SCALES_M))


def onset_time(times: np.ndarray, grid_point: int) -> float:
    """Look up the onset of a grid point in a trial with frames at times (F,) [s]."""
    onset, _ = split_grid_point(grid_point)
    return float(onset_times(times)[onset])


def grid_points_of_scale(scale_m: float) -> np.ndarray:
    """Find the grid points (W,) of the smallest scale that is at least `scale_m`."""
    first = np.arange(len(ONSET_SHARES)) * len(DISCREPANCY_SCALES_M)
    return first + int(np.searchsorted(DISCREPANCY_SCALES_M, scale_m))


def median_grid_point(grid_points: np.ndarray) -> int:
    """Choose the first onset and the median scale of some grid points."""
    return int(np.median(grid_points % len(DISCREPANCY_SCALES_M)))


def log_scale_prior() -> np.ndarray:
    """Compute the log prior of the scales, (S,): half-Cauchy between midpoints."""
    scales = DISCREPANCY_SCALES_M
    midpoints = np.sqrt(scales[1:-1] * scales[2:])
    edges = np.concatenate([[0.0, scales[1] / 2], midpoints, [np.inf]])
    cumulative = 2 / np.pi * np.arctan(edges / MEDIAN_SCALE_M)
    return np.asarray(np.log(np.diff(cumulative)))


def log_grid_prior() -> np.ndarray:
    """Compute the log prior of the grid points, (W S,)."""
    onsets = len(ONSET_SHARES)
    return np.tile(log_scale_prior() - np.log(onsets), onsets)


def marginal_log_likelihood(log_likelihoods: np.ndarray) -> np.ndarray:
    """Integrate the grid point out of log-likelihoods (..., W S)."""
    return np.asarray(logsumexp(log_likelihoods + log_grid_prior(), axis=-1))


def most_likely_grid_point(log_likelihoods: np.ndarray) -> np.ndarray:
    """Find the index of the most probable grid point from log-likelihoods (..., W S).

    If its scale is zero, the onset has no meaning and the first one is chosen.
    """
    grid_points = np.argmax(log_likelihoods + log_grid_prior(), axis=-1)
    has_discrepancy = grid_points % len(DISCREPANCY_SCALES_M) > 0
    return np.where(has_discrepancy, grid_points, 0)
