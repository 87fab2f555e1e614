"""Samples of a normal distribution that is cut at the faces of a box.

Hit-and-run: each step draws along a line through the last point, where the distribution
is normal, too (Belisle, Romeijn and Smith, Math. Oper. Res. 18, 255, 1993). Lines have
the directions of the distribution and of the axes in turn: the former go along narrow
valleys, the latter along faces of the box.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtr, ndtri

STEPS = 400
# of the diagonal: what no data touches is no wider than this allows
LEAST_CURVATURE = 1e-9


def sample_normal_in_box(
    precision: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    count: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw points (count, P) of a normal distribution about zero, within a box.

    Parameters
    ----------
    precision : (P, P) array
        Inverse of the covariance.
    lowest, highest : (P,) arrays
        Faces of the box, which contains zero.
    count : int
        Number of points.
    rng : numpy.random.Generator
        Source of randomness.
    """
    size = len(precision)
    unit = 1 / np.sqrt(np.diag(precision))
    scaled = precision * np.outer(unit, unit)
    low, high = lowest / unit, highest / unit
    root = np.linalg.cholesky(scaled + LEAST_CURVATURE * np.eye(size))
    points = np.zeros((count, size))
    for step in range(STEPS):
        if step % 2:
            normal = rng.standard_normal((size, count))
            direction = solve_triangular(root, normal, trans="T", lower=True).T
        else:
            direction = np.eye(size)[rng.integers(size, size=count)]
        slope = direction @ scaled
        curvature = np.sum(slope * direction, axis=1)
        centre = -np.sum(slope * points, axis=1) / curvature
        nearest, farthest = _distances_to_faces(points, direction, low, high)
        sd = 1 / np.sqrt(curvature)
        start, end = (nearest - centre) / sd, (farthest - centre) / sd
        distance = centre + sd * _draw_normal_between(start, end, rng)
        points += distance[:, None] * direction
        points = np.clip(points, low, high)  # of rounding
    return np.asarray(points * unit)


def _distances_to_faces(
    points: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measure how far lines through points (K, P) reach within a box, (K,) each.

    The first distance is the backward one, which is negative or zero.
    """
    moves = direction != 0
    divisor = np.where(moves, direction, 1.0)
    to_low = np.where(moves, (low - points) / divisor, -np.inf)
    to_high = np.where(moves, (high - points) / divisor, np.inf)
    backward = np.minimum(to_low, to_high).max(axis=1)
    forward = np.maximum(to_low, to_high).min(axis=1)
    return backward, forward


def _draw_normal_between(
    start: np.ndarray, end: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw standard normal numbers between limits (K,) each."""
    # small probabilities are exact only in the lower tail
    is_upper = start + end > 0
    lower = np.where(is_upper, -end, start)
    upper = np.where(is_upper, -start, end)
    below = ndtr(lower)
    probability = below + (ndtr(upper) - below) * rng.random(len(start))
    # where the tail underflows, the nearer limit is all that is likely
    drawn = np.where(probability > 0, ndtri(probability), upper)
    drawn = np.clip(drawn, lower, upper)
    return np.where(is_upper, -drawn, drawn)
