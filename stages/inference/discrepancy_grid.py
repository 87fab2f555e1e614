"""The grid of time courses and scales of a trial's discrepancy.

A discrepancy has one of several time courses, each with the same prior probability.
Misfit of the string's parameters grows over a trial like the sensitivity to them.
Misfit of a rest shape or of a geometry has the same size from the first frame on. And a
model may fit a trial until something unknown begins, such as a gust or a touch: before
this onset, a growing discrepancy is reduced to a hundredth, and points have nearly the
weight that they have without one.

The scale s [m] of a discrepancy is its root mean square at the tip over the trial. A
**grid point** is a course and a scale. Its index counts all scales of the first course
first.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

# Scales s, with a ratio of 1.56; the largest exceeds any misfit
DISCREPANCY_SCALES_M = np.concatenate([[0.0], np.geomspace(5e-5, 2.0, 25)])
MEDIAN_SCALE_M = 5e-4  # of the half-Cauchy prior of s
ONSET_SHARES = np.arange(6) / 6  # of the trial's duration: onsets of growing courses
COURSE_COUNT = len(ONSET_SHARES) + 1  # the last has a constant size
SHARE_BEFORE_ONSET = 0.01  # factor of the discrepancy before its onset


def onset_times(times: np.ndarray) -> np.ndarray:
    """Place the onsets of growing courses in a trial with frames at times (F,) [s]."""
    return np.asarray(times[0] + ONSET_SHARES * (times[-1] - times[0]))


def sizes_by_course(times: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """Compute the relative size of a discrepancy at each frame for each course, (W, F).

    Parameters
    ----------
    times : numpy.ndarray, shape (F,)
        Frame times [s].
    growth : numpy.ndarray, shape (F,)
        Relative size of a discrepancy that grows from the first frame on.
    """
    has_begun = times >= onset_times(times)[:, None]
    growing = np.where(has_begun, growth, SHARE_BEFORE_ONSET * growth)
    return np.vstack([growing, np.ones(len(times))])


def split_grid_point(grid_point: int) -> tuple[int, int]:
    """Look up the indices of the course and of the scale of a grid point."""
    return divmod(int(grid_point), len(DISCREPANCY_SCALES_M))


def onset_time(times: np.ndarray, grid_point: int) -> float:
    """Look up when the discrepancy of a grid point begins [s].

    times: of the trial's frames, (F,) [s].
    """
    course, _ = split_grid_point(grid_point)
    onsets = np.append(onset_times(times), times[0])
    return float(onsets[course])


def grid_points_of_later_onsets(scale_m: float) -> np.ndarray:
    """Find the grid points of discrepancies that begin during the trial.

    They have the smallest scale that is at least `scale_m`.
    """
    courses = np.flatnonzero(ONSET_SHARES)
    scale_index = int(np.searchsorted(DISCREPANCY_SCALES_M, scale_m))
    return courses * len(DISCREPANCY_SCALES_M) + scale_index


def median_grid_point(grid_points: np.ndarray) -> int:
    """Choose the first course and the median scale of some grid points."""
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
    return np.tile(log_scale_prior() - np.log(COURSE_COUNT), COURSE_COUNT)


def marginal_log_likelihood(log_likelihoods: np.ndarray) -> np.ndarray:
    """Integrate the grid point out of log-likelihoods (..., W S)."""
    return np.asarray(logsumexp(log_likelihoods + log_grid_prior(), axis=-1))


def most_likely_grid_point(log_likelihoods: np.ndarray) -> np.ndarray:
    """Find the index of the most probable grid point from log-likelihoods (..., W S).

    If its scale is zero, the course has no meaning and the first one is chosen.
    """
    grid_points = np.argmax(log_likelihoods + log_grid_prior(), axis=-1)
    has_discrepancy = grid_points % len(DISCREPANCY_SCALES_M) > 0
    return np.where(has_discrepancy, grid_points, 0)
