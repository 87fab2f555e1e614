"""Smooth functions of time and place, in which the motion of a string is expanded.

A film has thousands of numbers, the motion of a string some hundred: cubic B-splines in
time, and functions of place that are zero at the grasp. The products of the latter are
a squared exponential kernel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_array, hstack

# of the length: as of a string's first modes, which a hand moves most
PLACE_CORRELATION_SHARE = 0.35
PLACE_FUNCTIONS = 6  # nodes along the string: two for each correlation length
KNOT_SPACING_S = 0.015  # [s] from spline to spline: motion up to 30 Hz
MAX_SPLINES = 64  # longer trials have coarser splines
LOW_FREQUENCY_HZ = 15.0  # half of what trials of a second are followed to
MIN_FRAMES_PER_SPLINE = 2  # frames from spline to spline where the noise is estimated
RANK_TOLERANCE = 1e-8  # of the largest eigenvalue: less is no direction of its own
NODE_JITTER = 1e-9  # of the variance: keeps the covariance of nodes positive


def knot_spacing(times: np.ndarray) -> float:
    """Choose a knot spacing [s] that leaves some noise of frames at times (F,)."""
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    return max(KNOT_SPACING_S, MIN_FRAMES_PER_SPLINE * frame)


def time_nodes(times: np.ndarray, spacing: float) -> np.ndarray:
    """Place nodes [s] over times (F,), about `spacing` seconds apart."""
    intervals = int(np.ceil(float(np.ptp(times)) / spacing))
    count = min(intervals + 1, MAX_SPLINES)
    return np.linspace(times[0], times[-1], count)


def highest_frequency(times: np.ndarray) -> float:
    """Compute up to which frequency splines follow motion at times (F,) [Hz]."""
    nodes = time_nodes(times, KNOT_SPACING_S)
    return float((len(nodes) - 1) / (2 * np.ptp(nodes)))


def time_splines(times: np.ndarray, spacing: float = KNOT_SPACING_S) -> csr_array:
    """Evaluate cubic B-splines at times (F,), `spacing` seconds apart, (F, B)."""
    knots = np.pad(time_nodes(times, spacing), 3, mode="edge")
    return BSpline.design_matrix(times, knots, 3)


def place_functions(s: np.ndarray, length: float) -> np.ndarray:
    """Evaluate functions that are zero at the grasp at arc lengths (n,) [m], (n, K).

    length: of the string [m]. K: PLACE_FUNCTIONS.
    """
    nodes = length * np.arange(1, PLACE_FUNCTIONS + 1) / PLACE_FUNCTIONS
    correlation_length = PLACE_CORRELATION_SHARE * length

    def squared_exponential(gap: np.ndarray) -> np.ndarray:
        scaled = gap / correlation_length
        return np.asarray(np.exp(-0.5 * scaled**2))

    root = nystrom_root(s, nodes, squared_exponential)
    return root * (s / length)[:, None]


def tensor_products(time: csr_array, place: np.ndarray) -> csr_array:
    """Multiply functions of time (n, B) by functions of place (n, K), (n, K B)."""
    blocks = [csr_array(time.multiply(column[:, None])) for column in place.T]
    return csr_array(hstack(blocks, format="csr"))


def nystrom_root(
    points: np.ndarray,
    nodes: np.ndarray,
    kernel: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Compute a root (n, M) of a kernel's covariance of points (n,) from nodes (M,).

    It is the Nystrom approximation: root @ root.T is about kernel(|point - point'|).
    """
    among_nodes = kernel(np.abs(nodes[:, None] - nodes))
    among_nodes = among_nodes + NODE_JITTER * np.eye(len(nodes))
    to_nodes = kernel(np.abs(points[:, None] - nodes))
    node_root = cholesky(among_nodes, lower=True)
    root = solve_triangular(node_root, to_nodes.T, lower=True)
    return np.asarray(root.T)
