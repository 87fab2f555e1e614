"""The grid of time courses and scales of a trial's discrepancy.

A discrepancy has one of several time courses, each with the same prior probability:

- It grows from the first frame on, like the sensitivity to the string's parameters.
- It grows like this from an onset during the trial, when something unknown begins, such
  as a gust or a touch. Before its onset it is a hundredth of that, so that points have
  nearly the weight that they have without a discrepancy.
- It has the same size in all frames, like the misfit of a rest shape or of a geometry.

The scale s [m] of a discrepancy is its root mean square at the tip over the trial. Its
prior is half-Cauchy [1]_. A **grid point** is a course and a scale. Its index counts
all scales of the first course first. W is the number of courses, S that of scales.

References
----------
.. [1] Gelman, Bayesian Analysis 1, 515 (2006).
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

# Scales s, with a ratio of 1.56; the largest exceeds any misfit
DISCREPANCY_SCALES_M = np.concatenate([[0.0], np.geomspace(5e-5, 2.0, 25)])
SCALE_COUNT = len(DISCREPANCY_SCALES_M)
MEDIAN_SCALE_M = 5e-4  # of the half-Cauchy prior of s
ONSET_SHARES = np.arange(6) / 6  # of the trial's duration: onsets of growing courses
CONSTANT_COURSE = len(ONSET_SHARES)  # index of the course of constant size, the last
COURSE_COUNT = len(ONSET_SHARES) + 1
SHARE_BEFORE_ONSET = 0.01  # factor of the discrepancy before its onset


def onset_times(times: np.ndarray) -> np.ndarray:
    """Place the onsets of growing courses in a trial with frames at times (F,) [s]."""
    duration = times[-1] - times[0]
    return np.asarray(times[0] + ONSET_SHARES * duration)


def sizes_by_course(times: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """Compute the relative size of a discrepancy at each frame for each course.

    Parameters
    ----------
    times : numpy.ndarray, shape (F,)
        Frame times [s].
    growth : numpy.ndarray, shape (F,)
        Relative size of a discrepancy that grows from the first frame on.

    Returns
    -------
    numpy.ndarray, shape (W, F)
    """
    onsets = onset_times(times)
    has_begun = times >= onsets[:, None]  # (W - 1, F)
    before_onset = SHARE_BEFORE_ONSET * growth  # (F,)
    growing = np.where(has_begun, growth, before_onset)  # (W - 1, F)
    constant = np.ones(len(times))  # (F,)
    return np.vstack([growing, constant])


def split_grid_point(grid_point: int) -> tuple[int, int]:
    """Return the indices of the course and of the scale of a grid point."""
    return divmod(int(grid_point), SCALE_COUNT)


def onset_time(times: np.ndarray, grid_point: int) -> float:
    """Return when the discrepancy of a grid point begins [s].

    Parameters
    ----------
    times : numpy.ndarray, shape (F,)
        Frame times of the trial [s].
    grid_point : int
        Index of the course and the scale.
    """
    course, _ = split_grid_point(grid_point)
    if course == CONSTANT_COURSE:
        return float(times[0])
    return float(onset_times(times)[course])


def grid_points_of_later_onsets(scale_m: float) -> np.ndarray:
    """Find the grid points of discrepancies that begin during the trial.

    They have the smallest scale that is at least `scale_m`.
    """
    courses = np.flatnonzero(ONSET_SHARES)
    scale_index = int(np.searchsorted(DISCREPANCY_SCALES_M, scale_m))
    return courses * SCALE_COUNT + scale_index


def count_courses(grid_points: np.ndarray) -> np.ndarray:
    """Count the trials whose discrepancy has each course, (W,).

    grid_points: of the trials, (K,). A scale of zero is no discrepancy.
    """
    courses, scale_indices = np.divmod(grid_points, SCALE_COUNT)
    return np.bincount(courses[scale_indices > 0], minlength=COURSE_COUNT)


def typical_grid_point(grid_points: np.ndarray) -> int:
    """Choose the most frequent course and the median scale of trials (K,)."""
    course = int(np.argmax(count_courses(grid_points)))
    scale_index = int(np.median(grid_points % SCALE_COUNT))
    return course * SCALE_COUNT + scale_index


def log_scale_prior() -> np.ndarray:
    """Compute the log prior probability of each scale, (S,).

    A scale stands for the interval between the midpoints to its neighbours.
    """
    scales = DISCREPANCY_SCALES_M
    first_midpoint = scales[1] / 2
    midpoints = np.sqrt(scales[1:-1] * scales[2:])  # (S - 2,), geometric
    edges = np.concatenate([[0.0, first_midpoint], midpoints, [np.inf]])  # (S + 1,)
    cumulative = 2 / np.pi * np.arctan(edges / MEDIAN_SCALE_M)
    probabilities = np.diff(cumulative)
    return np.asarray(np.log(probabilities))


def log_grid_prior() -> np.ndarray:
    """Compute the log prior probability of each grid point, (W S,)."""
    of_one_course = log_scale_prior() - np.log(COURSE_COUNT)
    return np.tile(of_one_course, COURSE_COUNT)


def marginal_log_likelihood(log_likelihoods: np.ndarray) -> np.ndarray:
    """Integrate the grid point out of log-likelihoods (..., W S)."""
    log_joint = log_likelihoods + log_grid_prior()
    return np.asarray(logsumexp(log_joint, axis=-1))


def most_likely_grid_point(log_likelihoods: np.ndarray) -> np.ndarray:
    """Find the index of the most probable grid point from log-likelihoods (..., W S).

    If its scale is zero, the course has no meaning and the first one is chosen.
    """
    log_joint = log_likelihoods + log_grid_prior()
    grid_points = np.argmax(log_joint, axis=-1)
    has_discrepancy = grid_points % SCALE_COUNT > 0
    return np.where(has_discrepancy, grid_points, 0)
