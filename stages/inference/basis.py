"""Smooth functions of time and place that span the motion of a string.

A film has thousands of coordinates, the motion of a string some hundred degrees of
freedom. The functions are products of cubic B-splines in time and functions of place
that are zero at the grasp. The latter are a root of a squared exponential kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cholesky, solve_triangular

from stringcast.stages.model.engine.threads import compile_kernel

# of the length: that of a string's first modes, which a hand excites most
PLACE_CORRELATION_SHARE = 0.35
PLACE_FUNCTIONS = 6  # nodes along the string: two per correlation length
KNOT_SPACING_S = 0.015  # resolves motion up to 30 Hz
MAX_SPLINES = 64  # longer trials have wider spacings
LOW_FREQUENCY_HZ = 15.0  # half of what splines resolve in trials of a second
MIN_FRAMES_PER_SPLINE = 2  # least knot spacing where the noise is estimated
RANK_TOLERANCE = 1e-8  # of the largest eigenvalue: smaller ones count as zero
NODE_JITTER = 1e-9  # of the variance: keeps the covariance of nodes positive definite


def knot_spacing(times: np.ndarray) -> float:
    """Choose a knot spacing [s] too wide to fit all noise of frames at times (F,)."""
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    return max(KNOT_SPACING_S, MIN_FRAMES_PER_SPLINE * frame)


def time_nodes(times: np.ndarray, spacing: float) -> np.ndarray:
    """Place nodes [s] over times (F,), about `spacing` seconds apart."""
    intervals = int(np.ceil(float(np.ptp(times)) / spacing))
    count = min(intervals + 1, MAX_SPLINES)
    return np.linspace(times[0], times[-1], count)


def highest_frequency(times: np.ndarray) -> float:
    """Compute the highest frequency that splines resolve at times (F,) [Hz]."""
    nodes = time_nodes(times, KNOT_SPACING_S)
    return float((len(nodes) - 1) / (2 * np.ptp(nodes)))


def time_splines(times: np.ndarray, spacing: float = KNOT_SPACING_S) -> np.ndarray:
    """Evaluate cubic B-splines at times (F,), `spacing` seconds apart, (F, B)."""
    knots = np.pad(time_nodes(times, spacing), 3, mode="edge")
    return np.asarray(BSpline.design_matrix(times, knots, 3).toarray())


def place_functions(s: np.ndarray, length: float) -> np.ndarray:
    """Evaluate functions of place, zero at the grasp, at arc lengths (n,) [m], (n, K).

    length: that of the string [m]. K: PLACE_FUNCTIONS.
    """
    nodes = length * np.arange(1, PLACE_FUNCTIONS + 1) / PLACE_FUNCTIONS
    correlation_length = PLACE_CORRELATION_SHARE * length

    def squared_exponential(gap: np.ndarray) -> np.ndarray:
        scaled = gap / correlation_length
        return np.asarray(np.exp(-0.5 * scaled**2))

    root = nystrom_root(s, nodes, squared_exponential)
    return root * (s / length)[:, None]


def nystrom_root(
    points: np.ndarray,
    nodes: np.ndarray,
    kernel: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Compute a root (n, M) of a kernel at points (n,) from nodes (M,).

    By the Nystrom approximation, root @ root.T is about kernel(|point - point'|).
    """
    among_nodes = kernel(np.abs(nodes[:, None] - nodes))
    among_nodes = among_nodes + NODE_JITTER * np.eye(len(nodes))
    to_nodes = kernel(np.abs(points[:, None] - nodes))
    node_root = cholesky(among_nodes, lower=True)
    root = solve_triangular(node_root, to_nodes.T, lower=True)
    return np.asarray(root.T)


@dataclass(frozen=True)
class SmoothFunctions:
    """Products of functions of time and of place at the points of a trial.

    Product k B + b is that of the function of place k and the spline b, K B in all.
    Functions of time are constant within a frame, so that sums go over its points
    first.

    Parameters
    ----------
    in_time
        Splines at the frames, (F, B).
    in_place
        Functions of place at the points, (n, K).
    frame
        Frame of each point, (n,).
    """

    in_time: np.ndarray
    in_place: np.ndarray
    frame: np.ndarray

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sum values (C, 2 n) times each function over the points, (2 C, K B).

        The rows of a candidate are those of x and y.
        """
        frames, splines = self.in_time.shape
        places = self.in_place.shape[1]
        by_frame = np.zeros((len(values), 2, frames, places))
        by_point = values.reshape(len(values), len(self.frame), 2)
        _sum_over_points(by_point, self.in_place, self.frame, by_frame)
        by_place = by_frame.transpose(0, 1, 3, 2)  # (C, 2, K, F)
        return np.asarray((by_place @ self.in_time).reshape(-1, places * splines))

    def at_points(self, factors: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Sum the functions times factors (2 C, K B) at some of the points, (C, 2 q).

        factors: rows as in `sums`. chosen: a mask of the q points, (n,).
        """
        places = self.in_place.shape[1]
        by_place = factors.reshape(-1, 2, places, self.in_time.shape[1])
        by_frame = by_place @ self.in_time.T  # (C, 2, K, F)
        frame = self.frame[chosen]
        sums = np.zeros((len(by_frame), len(frame), 2))
        for k in range(places):
            of_place = by_frame[:, :, k, frame] * self.in_place[chosen, k]
            sums += of_place.transpose(0, 2, 1)
        return sums.reshape(len(by_frame), -1)

    def gram_by_frame(self, weight: np.ndarray) -> np.ndarray:
        """Compute Gram matrices of the functions of place in each frame, (F, K, K).

        weight: weights of the points, (n,).
        """
        places = self.in_place.shape[1]
        gram = np.zeros((len(self.in_time), places, places))
        weighted = weight[:, None] * self.in_place
        products = weighted[:, :, None] * self.in_place[:, None, :]
        np.add.at(gram, self.frame, products)
        return gram


def sum_products(
    in_time: np.ndarray, other: np.ndarray, gram: np.ndarray
) -> np.ndarray:
    """Compute scalar products of two sets of functions over the points, (K B, K R).

    Each function is a function of time times a function of place. Both sets have the
    same functions of place.

    in_time, other: functions of time at the frames, (F, B) and (F, R). gram: see
    `SmoothFunctions.gram_by_frame`, (F, K, K).
    """
    frames, splines = in_time.shape
    places = gram.shape[1]
    weighted = gram[:, :, :, None] * in_time[:, None, None, :]
    sums = weighted.reshape(frames, -1).T @ other
    by_place = sums.reshape(places, places, splines, -1).transpose(0, 2, 1, 3)
    return np.asarray(by_place.reshape(places * splines, -1))


@compile_kernel
def _sum_over_points(
    values: np.ndarray, in_place: np.ndarray, frame: np.ndarray, sums: np.ndarray
) -> None:
    """Add values (C, n, 2) times functions of place (n, K) to sums (C, 2, F, K)."""
    for c in range(len(values)):
        for i in range(len(frame)):
            x, y = values[c, i, 0], values[c, i, 1]
            of_x, of_y = sums[c, 0, frame[i]], sums[c, 1, frame[i]]
            for k in range(in_place.shape[1]):
                of_x[k] += in_place[i, k] * x
                of_y[k] += in_place[i, k] * y
