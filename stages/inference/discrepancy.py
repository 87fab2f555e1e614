"""What a model lacks in a trial, as a smooth random displacement of the string (Kennedy and O'Hagan 2001).

    simulated - measured = U a + s d + e,        d ~ GP,   a ~ N(0, 1),   e ~ N(0, sigma^2)

d is zero at the grasp, smooth along the string (squared exponential, 0.35 L) and in time (Matern 3/2), and grows over
the trial as any small change of the model's parameters does. Its size s [m], root mean square at the tip, is unknown
for every trial: half-Cauchy, on a grid. U are the modes of the trial's beginning.

A film has thousands of numbers, the motion of a string some hundred. So a trial is told by its coefficients in a basis
of smooth functions of time and place (Higdon et al. 2008, JASA 103, 570), turned such that noise is white and the
discrepancy diagonal: a size s then costs nothing to try. What is left beside them is noise, whose size it tells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cholesky, eigh, solve_triangular
from scipy.sparse import csr_array, hstack
from scipy.special import logsumexp

from stringcast.stages.common import mad_sigma
from stringcast.stages.inference.forward import Case
from stringcast.stages.inference.whitening import LowRank

MEMORY = 0.08  # [s] of the Matern kernel: a quarter of the swing of a string of 0.3 m, 2 pi / 2.405 sqrt(L/g)
ALONG = 0.35  # of the length: of a string's first modes, which a hand moves most
PLACES = 6  # nodes along the string: two for each correlation length
KNOTS = 0.015  # [s] from spline to spline: motion up to 30 Hz
MOST = 64  # splines at most: longer trials are told more coarsely
SIZES = np.concatenate([[0.0], np.geomspace(5e-5, 2.0, 25)])  # [m] of s: each 1.56 times the last; no string is as far
TYPICAL = 5e-4  # [m] of s: half of all trials have less (half-Cauchy)
APART = 3  # frames from spline to spline, at least, where noise is told
FREE = 0.2  # of all points: with fewer beside what splines tell, they do not tell the noise
RANK = 1e-8  # of the largest eigenvalue: less is no direction of its own


@dataclass(frozen=True)
class Discrepancy:
    """Of one trial, in M coefficients for each coordinate.

    splines: (n, B) at the measured points. turn: (M, B) from sums over points, of residuals over sigma times splines,
    to coefficients; unturn: (B, M) back to splines. variance: (M,) of the discrepancy for s = 1 m. nuisance: U in
    coefficients, (2 M, m); modes: as it is, (2 n, m).
    """

    splines: csr_array
    turn: np.ndarray
    unturn: np.ndarray
    variance: np.ndarray
    nuisance: np.ndarray
    modes: np.ndarray

    @classmethod
    def of(cls, trial: Case, growth: np.ndarray, nuisance: np.ndarray) -> Discrepancy:
        """growth: of d at each frame, (F,). nuisance: U over sigma, (2 n, m)."""
        splines = _splines(trial)
        values, vectors = eigh((splines.T @ splines).toarray())
        kept = values > RANK * values[-1]
        told = (vectors[:, kept] / np.sqrt(values[kept])).T  # orthonormal coefficients of what splines tell
        smooth = told @ (splines.T @ _kernel_root(trial, growth))
        variance, turn = eigh(smooth @ smooth.T)
        made = cls(splines, turn.T @ told, told.T @ turn, np.maximum(variance, 0.0), np.zeros((0, 0)), nuisance)
        return replace(made, nuisance=made.coefficients(nuisance.T).T)

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """(C, 2 M) of residuals over sigma (C, 2 n)."""
        count, points, number = len(residual), self.splines.shape[0], len(self.turn)
        by_point = residual.reshape(count, points, 2).transpose(1, 0, 2).reshape(points, 2 * count)
        found = self.turn @ (self.splines.T @ by_point)
        return np.asarray(found.reshape(number, count, 2).transpose(1, 0, 2).reshape(count, 2 * number))

    def white(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        """V(s)^(-1/2) of coefficients (C, 2 M), at a number of SIZES."""
        deviation, rank = self._whitening[size]
        return rank(coefficients / deviation)

    def log_likelihoods(self, coefficients: np.ndarray) -> np.ndarray:
        """Of coefficients (C, 2 M) at all SIZES, (C, S)."""
        return np.stack([self._log_likelihood(coefficients, size) for size in range(len(SIZES))], axis=1)

    def mean(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        """The discrepancy over sigma (2 n,) that coefficients (2 M,) leave most likely."""
        variance = np.repeat(SIZES[size] ** 2 * self.variance, 2)
        known = coefficients - self.nuisance @ self._amplitudes(coefficients, size)
        told = (known * variance / (1.0 + variance)).reshape(-1, 2)
        return np.asarray((self.splines @ (self.unturn @ told)).ravel())

    def beginning(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        """What another beginning most likely explains of coefficients (2 M,), over sigma, (2 n,)."""
        return np.asarray(self.modes @ self._amplitudes(coefficients, size))

    def _amplitudes(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        deviation, _ = self._whitening[size]
        root = self.nuisance / deviation[:, None]
        return np.asarray(np.linalg.solve(np.eye(root.shape[1]) + root.T @ root, root.T @ (coefficients / deviation)))

    def draws(self, coefficients: np.ndarray, size: int, count: int, rng: np.random.Generator) -> np.ndarray:
        """Discrepancies over sigma (count, 2 n) as likely as coefficients (2 M,) leave them."""
        variance = np.repeat(SIZES[size] ** 2 * self.variance, 2)
        scatter = rng.standard_normal((count, len(variance))) * np.sqrt(variance / (1.0 + variance))
        told = scatter.reshape(count, -1, 2).transpose(1, 0, 2).reshape(-1, 2 * count)
        off = (self.splines @ (self.unturn @ told)).reshape(-1, count, 2).transpose(1, 0, 2).reshape(count, -1)
        return np.asarray(self.mean(coefficients, size) + off)

    @cached_property
    def _whitening(self) -> list[tuple[np.ndarray, LowRank]]:
        """Deviations (2 M,) of coefficients without nuisance, and what whitens them then, at each of SIZES."""
        deviations = [np.repeat(np.sqrt(1.0 + size**2 * self.variance), 2) for size in SIZES]
        return [(each, LowRank.of(self.nuisance / each[:, None])) for each in deviations]

    def _log_likelihood(self, coefficients: np.ndarray, size: int) -> np.ndarray:
        deviation, rank = self._whitening[size]
        square = np.sum(rank(coefficients / deviation) ** 2, axis=1)
        return np.asarray(-0.5 * square - np.log(deviation).sum() + np.log1p(-rank.taken).sum())


def smoothed(trial: Case, residual: np.ndarray) -> tuple[np.ndarray, float]:
    """What residuals (n, 2) over sigma have beside smooth motion, and the noise over sigma that it tells, robustly; all
    of them where there are too few to tell."""
    frame = float(np.median(np.diff(trial.times))) if len(trial.times) > 1 else 0.0
    splines = _splines(trial, max(KNOTS, APART * frame))
    gram = (splines.T @ splines).toarray()
    free = 1 - np.linalg.matrix_rank(gram) / len(residual)
    if free < FREE:
        return residual, float(mad_sigma(residual))
    beside = residual - splines @ np.linalg.lstsq(gram, splines.T @ residual, rcond=RANK)[0]
    return beside, float(mad_sigma(beside) / np.sqrt(free))


def log_prior() -> np.ndarray:
    """Of SIZES, half-Cauchy: what lies between the middles of neighbours, (S,)."""
    edges = np.concatenate([[0.0, SIZES[1] / 2], np.sqrt(SIZES[1:-1] * SIZES[2:]), [np.inf]])
    return np.asarray(np.log(np.diff(2 / np.pi * np.arctan(edges / TYPICAL))))


def marginal(log_likelihoods: np.ndarray) -> np.ndarray:
    """Log-likelihood whatever s is, of (..., S)."""
    return np.asarray(logsumexp(log_likelihoods + log_prior(), axis=-1))


def likeliest(log_likelihoods: np.ndarray) -> np.ndarray:
    """Number of the likeliest of SIZES, of (..., S)."""
    return np.asarray(np.argmax(log_likelihoods + log_prior(), axis=-1))


def _nodes(trial: Case, every: float) -> np.ndarray:
    span = float(np.ptp(trial.times))
    return np.linspace(trial.times[0], trial.times[-1], min(int(np.ceil(span / every)) + 1, MOST))


def _splines(trial: Case, every: float = KNOTS) -> csr_array:
    """Products of cubic B-splines in time, one every so many seconds, with smooth functions of place, at the measured
    points, (n, M)."""
    nodes = _nodes(trial, every)
    knots = np.concatenate([[nodes[0]] * 3, nodes, [nodes[-1]] * 3])
    time = BSpline.design_matrix(trial.times[trial.frame], knots, 3)
    along = _along(trial)
    parts = [csr_array(time.multiply(column[:, None])) for column in along.T]
    return csr_array(hstack(parts, format="csr"))


def _along(trial: Case) -> np.ndarray:
    """Functions of place that are zero at the grasp, (n, PLACES), whose products are the kernel along the string."""
    length = trial.model.string.length
    places = length * np.arange(1, PLACES + 1) / PLACES
    found = _columns(trial.s, places, lambda gap: np.exp(-0.5 * (gap / (ALONG * length)) ** 2))
    return np.asarray(found * (trial.s / length)[:, None])


def _kernel_root(trial: Case, growth: np.ndarray) -> np.ndarray:
    """Columns (n, K) whose products are the covariance of the discrepancy, of unit mean square at the tip."""
    nodes = _nodes(trial, KNOTS)
    memory = max(MEMORY, 2 * (nodes[1] - nodes[0]))
    time = _columns(trial.times, nodes, lambda gap: _matern(gap / memory))[trial.frame]
    grown = (growth / np.sqrt(np.mean(growth**2)))[trial.frame] / trial.sigma
    return np.asarray(((grown[:, None] * time)[:, :, None] * _along(trial)[:, None, :]).reshape(len(trial.s), -1))


def _columns(where: np.ndarray, nodes: np.ndarray, kernel: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Square root of a kernel told by its nodes (n, M) (Nystrom)."""
    root = cholesky(kernel(np.abs(nodes[:, None] - nodes)) + 1e-9 * np.eye(len(nodes)), lower=True)
    return np.asarray(solve_triangular(root, kernel(np.abs(where[:, None] - nodes)).T, lower=True).T)


def _matern(gap: np.ndarray) -> np.ndarray:
    """Matern 3/2 of gaps over its memory."""
    return np.asarray((1 + np.sqrt(3) * gap) * np.exp(-np.sqrt(3) * gap))
