"""Smooth functions of time and place, in which the motion of a string is told.

A film has thousands of numbers, the motion of a string some hundred: cubic B-splines in
time, and along the string functions that are zero at the grasp, whose products are a
squared exponential kernel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_array, hstack

# of the length: of a string's first modes, which a hand moves most
PLACE_CORRELATION_SHARE = 0.35
PLACE_FUNCTIONS = 6  # nodes along the string: two for each correlation length
KNOT_SPACING_S = 0.015  # [s] from spline to spline: motion up to 30 Hz
MAX_SPLINES = 64  # splines at most: longer trials are told more coarsely
MIN_FRAMES_PER_SPLINE = 2  # frames from spline to spline, at least, where noise is told
RANK_TOLERANCE = 1e-8  # of the largest eigenvalue: less is no direction of its own


def knot_spacing(times: np.ndarray) -> float:
    """Time from spline to spline [s] beside which something is left of frames at these
    times (F,).
    """
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    return max(KNOT_SPACING_S, MIN_FRAMES_PER_SPLINE * frame)


def time_nodes(times: np.ndarray, every: float) -> np.ndarray:
    """Where splines in time are [s], one every so many seconds [s]."""
    span = float(np.ptp(times))
    return np.linspace(
        times[0], times[-1], min(int(np.ceil(span / every)) + 1, MAX_SPLINES)
    )


def time_splines(times: np.ndarray, every: float = KNOT_SPACING_S) -> csr_array:
    """Cubic B-splines at frames (F,), one every so many seconds, (F, B)."""
    at = time_nodes(times, every)
    knots = np.concatenate([[at[0]] * 3, at, [at[-1]] * 3])
    return BSpline.design_matrix(times, knots, 3)


def place_functions(s: np.ndarray, length: float) -> np.ndarray:
    """Functions of place that are zero at the grasp, at arc lengths (n,) of a string
    [m], (n, PLACES).
    """
    places = length * np.arange(1, PLACE_FUNCTIONS + 1) / PLACE_FUNCTIONS
    found = nystrom_root(
        s,
        places,
        lambda gap: np.exp(-0.5 * (gap / (PLACE_CORRELATION_SHARE * length)) ** 2),
    )
    return np.asarray(found * (s / length)[:, None])


def tensor_products(time: csr_array, place: np.ndarray) -> csr_array:
    """Functions of time (n, B) times functions of place (n, K), (n, K B)."""
    return csr_array(
        hstack(
            [csr_array(time.multiply(column[:, None])) for column in place.T],
            format="csr",
        )
    )


def nystrom_root(
    where: np.ndarray, at: np.ndarray, kernel: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Square root of a kernel told by its nodes, (n, M) (Nystrom)."""
    root = cholesky(
        kernel(np.abs(at[:, None] - at)) + 1e-9 * np.eye(len(at)), lower=True
    )
    return np.asarray(
        solve_triangular(root, kernel(np.abs(where[:, None] - at)).T, lower=True).T
    )
