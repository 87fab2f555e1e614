"""The discrepancy of a model in a trial: a Gaussian process.

    simulated - measured = U a + s d + e,      d ~ GP,   a ~ N(0, 1),   e: noise

d is zero at the grasp, smooth along the string (squared exponential, 0.35 L) and in
time (Matern 3/2), and grows over the trial as any small change of the parameters does.
Its scale s [m], the root mean square at the tip, is unknown in every trial:
half-Cauchy, on a grid. U are the modes of the trial's initial state.

A trial is expanded in a basis of smooth functions of time and place, turned such that
noise (`noise`) is white and the discrepancy diagonal. Trying a scale then costs
nothing. What the basis does not reach is noise, and gives its size.

U has three kinds of columns, in this order: modes of the initial state, the uncertain
part of the discretisation error, and random effects of causes.

References
----------
Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425. Higdon et al. 2008, JASA 103, 570.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.special import logsumexp

from stringcast.stages.common import mad_sigma, rms
from stringcast.stages.inference.basis import (
    KNOT_SPACING_S,
    RANK_TOLERANCE,
    knot_spacing,
    nystrom_root,
    place_functions,
    tensor_products,
    time_nodes,
    time_splines,
)
from stringcast.stages.inference.content_cache import ContentCache
from stringcast.stages.inference.noise import MeasuredTrial, gram_roots
from stringcast.stages.inference.whitening import LowRankWhitening

MATERN_TIME_S = 0.08  # [s]: 0.05 to 0.12 suited nine fits of strings of 0.3 m
# Scales s [m], each 1.56 times the last; no string is farther off.
DISCREPANCY_SCALES_M = np.concatenate([[0.0], np.geomspace(5e-5, 2.0, 25)])
MEDIAN_SCALE_M = 5e-4  # [m] of s: half of all trials have less (half-Cauchy)
# of all numbers: fewer beyond what splines reach do not give the noise
MIN_FREE_SHARE = 0.2
MAX_KEPT_TRIALS = 64  # some 4 MB each, in each of two caches


@dataclass(frozen=True)
class NoiseBasis:
    """Splines of a trial, and coefficients of them in which its noise is white.

    It depends on times and places of the measured points, and on their noise.

    Parameters
    ----------
    splines
        Basis functions at the measured points, (n, B).
    whiten
        From sums over points of residuals over sigma times splines to coefficients, (M,
        B).
    vectors
        Directions of splines that the points determine, (B, M).
    gram
        Coefficients of these directions themselves, (M, M).
    """

    splines: csr_array
    whiten: np.ndarray
    vectors: np.ndarray
    gram: np.ndarray

    @classmethod
    def for_trial(cls, trial: MeasuredTrial) -> NoiseBasis:
        """Find the basis of a trial, kept since the last correction of its points."""
        parts = _basis_parts(trial)
        return _KEPT_BASES.find_or_make(parts, lambda: cls._build(trial))

    @classmethod
    def _build(cls, trial: MeasuredTrial) -> NoiseBasis:
        time = time_splines(trial.times)
        place = place_functions(trial.s, trial.model.string.length)
        splines = tensor_products(time[trial.frame], place)
        roots = gram_roots(place, trial.frame, len(trial.times))
        values, vectors = eigh(trial.noise.covariance(time, roots))
        kept = values > RANK_TOLERANCE * values[-1]
        vectors = vectors[:, kept]
        whiten = (vectors / np.sqrt(values[kept])).T
        gram = whiten @ (splines.T @ splines).toarray() @ vectors
        return cls(splines, whiten, vectors, gram)


def _basis_parts(trial: MeasuredTrial) -> list[np.ndarray]:
    """List all that decides the basis of a trial."""
    noise = trial.noise
    numbers = np.array([trial.model.string.length, noise.frame_correlation])
    return [trial.times, trial.frame, trial.s, noise.place_covariance, numbers]


_KEPT_BASES: ContentCache[NoiseBasis] = ContentCache(MAX_KEPT_TRIALS)


@dataclass(frozen=True)
class Discrepancy:
    """The discrepancy of one trial, in M coefficients for each coordinate.

    Parameters
    ----------
    splines
        Basis functions at the measured points, (n, B).
    to_coefficients
        From sums over points of residuals over sigma times splines to coefficients, (M,
        B).
    to_splines
        From coefficients back to splines, (B, M).
    variance
        Of the coefficients of a discrepancy of s = 1 m, (M,).
    nuisance_coefficients
        U in coefficients, (2 M, m).
    nuisance_shapes
        U at the points over sigma, (2 n, m).
    """

    splines: csr_array
    to_coefficients: np.ndarray
    to_splines: np.ndarray
    variance: np.ndarray
    nuisance_coefficients: np.ndarray
    nuisance_shapes: np.ndarray
    scale: ClassVar[float] = 1.0  # of noise, in the points' own sigma

    @classmethod
    def for_trial(
        cls,
        trial: MeasuredTrial,
        growth: np.ndarray,
        nuisance: np.ndarray,
    ) -> Discrepancy:
        """Find the basis of a trial in which noise and discrepancy are diagonal.

        Parameters
        ----------
        trial
            Only its points' times, places and noise count, not where they are.
        growth
            Relative size of d at each frame, (F,).
        nuisance
            U over sigma, (2 n, m).
        """
        parts = [*_basis_parts(trial), trial.sigma, growth]
        without_nuisance = _KEPT_DISCREPANCIES.find_or_make(
            parts, lambda: cls._without_nuisance(trial, growth)
        )
        return without_nuisance.with_nuisance(nuisance)

    @classmethod
    def _without_nuisance(cls, trial: MeasuredTrial, growth: np.ndarray) -> Discrepancy:
        basis = NoiseBasis.for_trial(trial)
        splines = basis.splines
        whiten = basis.whiten

        # Rotated such that the discrepancy is diagonal
        smooth_root = whiten @ (splines.T @ _kernel_root(trial, growth))
        variance, rotation = eigh(smooth_root @ smooth_root.T)

        # Back to splines, by the coefficients of the splines themselves
        to_splines = basis.vectors @ np.linalg.solve(basis.gram, rotation)

        return cls(
            splines,
            to_coefficients=rotation.T @ whiten,
            to_splines=to_splines,
            variance=np.maximum(variance, 0.0),
            nuisance_coefficients=np.zeros((2 * len(variance), 0)),
            nuisance_shapes=np.zeros((2 * len(trial.s), 0)),
        )

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n) in the basis, (C, 2 M)."""
        count = len(residual)
        points = self.splines.shape[0]
        number = len(self.to_coefficients)
        by_point = residual.reshape(count, points, 2).transpose(1, 0, 2)
        sums = self.splines.T @ by_point.reshape(points, 2 * count)
        by_basis = (self.to_coefficients @ sums).reshape(number, count, 2)
        return np.asarray(by_basis.transpose(1, 0, 2).reshape(count, 2 * number))

    def with_nuisance(self, shapes: np.ndarray) -> Discrepancy:
        """Add nuisance shapes (2 n, m) over sigma after the present ones."""
        added = self.coefficients(shapes.T).T
        return replace(
            self,
            nuisance_coefficients=np.hstack([self.nuisance_coefficients, added]),
            nuisance_shapes=np.hstack([self.nuisance_shapes, shapes]),
        )

    def replace_leading_nuisance(self, shapes: np.ndarray, count: int) -> Discrepancy:
        """Replace the first `count` nuisance shapes by others (2 n, m) over sigma."""
        first = self.coefficients(shapes.T).T
        later = self.nuisance_coefficients[:, count:]
        later_shapes = self.nuisance_shapes[:, count:]
        return replace(
            self,
            nuisance_coefficients=np.hstack([first, later]),
            nuisance_shapes=np.hstack([shapes, later_shapes]),
        )

    def whiten(self, residual: np.ndarray, scale_index: int) -> np.ndarray:
        """Compute V(s)^(-1/2) of residuals over sigma (C, 2 n), (C, 2 M)."""
        return self.whiten_coefficients(self.coefficients(residual), scale_index)

    def whiten_coefficients(
        self,
        coefficients: np.ndarray,
        scale_index: int,
    ) -> np.ndarray:
        """Compute V(s)^(-1/2) of coefficients (C, 2 M)."""
        if scale_index not in self._whitenings:
            deviation = np.sqrt(1.0 + self._variance_at(scale_index))
            columns = self.nuisance_coefficients / deviation[:, None]
            whitening = LowRankWhitening.from_columns(columns)
            self._whitenings[scale_index] = (deviation, whitening)
        deviation, whitening = self._whitenings[scale_index]
        return whitening(coefficients / deviation)

    def log_likelihood_by_scale(self, coefficients: np.ndarray) -> np.ndarray:
        """Compute the log-likelihood of coefficients (C, 2 M) at all scales, (C, S).

        With V = D + U U', by the Woodbury identity and the determinant lemma
        (Harville 1997, Matrix Algebra From a Statistician's Perspective, 18.1-2).
        """
        precision, covariance, log_determinant = self._nuisance_by_scale
        weighted = precision[:, None] * coefficients  # (S, C, 2 M)
        square = np.sum(weighted * coefficients, axis=2)
        projected = weighted @ self.nuisance_coefficients  # (S, C, m)
        explained = np.sum((projected @ covariance) * projected, axis=2)
        log_likelihood = -0.5 * (square - explained + log_determinant[:, None])
        return np.asarray(log_likelihood.T)

    def posterior_mean(self, coefficients: np.ndarray, scale_index: int) -> np.ndarray:
        """Compute the most likely discrepancy over sigma, (2 n,).

        coefficients: of the residual, (2 M,).
        """
        variance = self._variance_at(scale_index)
        amplitudes = self._nuisance_amplitudes(coefficients, scale_index)
        explained = self.nuisance_coefficients @ amplitudes
        smooth = (coefficients - explained) * variance / (1.0 + variance)
        by_spline = self.to_splines @ smooth.reshape(-1, 2)
        return np.asarray((self.splines @ by_spline).ravel())

    def sample_posterior(
        self,
        coefficients: np.ndarray,
        scale_index: int,
        count: int,
        rng: np.random.Generator,
        chosen: np.ndarray,
    ) -> np.ndarray:
        """Draw discrepancies over sigma (count, 2 m) given coefficients (2 M,).

        chosen: a mask of the m points at which they are wanted, (n,).
        """
        variance = self._variance_at(scale_index)
        normal = rng.standard_normal((count, len(variance)))
        scatter = normal * np.sqrt(variance / (1.0 + variance))
        by_basis = scatter.reshape(count, -1, 2).transpose(1, 0, 2)
        by_spline = self.to_splines @ by_basis.reshape(-1, 2 * count)
        by_point = (self.splines[chosen] @ by_spline).reshape(-1, count, 2)
        offset = by_point.transpose(1, 0, 2).reshape(count, -1)
        mean = self.posterior_mean(coefficients, scale_index)
        return np.asarray(mean[np.repeat(chosen, 2)] + offset)

    def nuisance_mean(self, coefficients: np.ndarray, scale_index: int) -> np.ndarray:
        """Compute what the nuisance most likely explains of coefficients, (2 n,)."""
        amplitudes = self._nuisance_amplitudes(coefficients, scale_index)
        return np.asarray(self.nuisance_shapes @ amplitudes)

    def _nuisance_amplitudes(
        self,
        coefficients: np.ndarray,
        scale_index: int,
    ) -> np.ndarray:
        precision, covariance, _ = self._nuisance_by_scale
        weighted = precision[scale_index] * coefficients
        projected = weighted @ self.nuisance_coefficients
        return np.asarray(covariance[scale_index] @ projected)

    def _variance_at(self, scale_index: int) -> np.ndarray:
        """Variance of the discrepancy's coefficients at a scale, (2 M,)."""
        scale_m = DISCREPANCY_SCALES_M[scale_index]
        return np.repeat(scale_m**2 * self.variance, 2)

    @cached_property
    def _whitenings(self) -> dict[int, tuple[np.ndarray, LowRankWhitening]]:
        """Deviations (2 M,) without nuisance and the rest of V, at scales by index."""
        return {}

    @cached_property
    def _nuisance_by_scale(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute what the nuisance does at each scale.

        Returns D^-1 (S, 2 M), the covariance (1 + U' D^-1 U)^-1 (S, m, m) of the
        nuisance's amplitudes given the data, and ln |V| (S,).
        """
        scales = range(len(DISCREPANCY_SCALES_M))
        variance = np.stack([self._variance_at(index) for index in scales])
        precision = 1.0 / (1.0 + variance)
        shapes = self.nuisance_coefficients
        information = (shapes.T * precision[:, None]) @ shapes
        information += np.eye(shapes.shape[1])
        log_determinant = np.log1p(variance).sum(axis=1)
        log_determinant += np.linalg.slogdet(information)[1]
        return precision, np.linalg.inv(information), log_determinant


_KEPT_DISCREPANCIES: ContentCache[Discrepancy] = ContentCache(MAX_KEPT_TRIALS)


def remove_smooth_motion(
    trial: MeasuredTrial,
    residual: np.ndarray,
) -> tuple[np.ndarray, float]:
    """Remove smooth motion from residuals (n, 2) over sigma.

    Returns the rest and the noise over sigma, estimated robustly from it. Where too few
    numbers are left to do that, nothing is removed.
    """
    time = time_splines(trial.times, knot_spacing(trial.times))
    place = place_functions(trial.s, trial.model.string.length)
    splines = tensor_products(time[trial.frame], place)
    gram = (splines.T @ splines).toarray()
    free_share = 1 - np.linalg.matrix_rank(gram) / len(residual)
    if free_share < MIN_FREE_SHARE:
        return residual, float(mad_sigma(residual))
    sums = splines.T @ residual
    by_spline = np.linalg.lstsq(gram, sums, rcond=RANK_TOLERANCE)[0]
    rest = residual - splines @ by_spline
    return rest, float(mad_sigma(rest) / np.sqrt(free_share))


def log_scale_prior() -> np.ndarray:
    """Compute the log prior of the scales, (S,): half-Cauchy between midpoints."""
    scales = DISCREPANCY_SCALES_M
    midpoints = np.sqrt(scales[1:-1] * scales[2:])
    edges = np.concatenate([[0.0, scales[1] / 2], midpoints, [np.inf]])
    cumulative = 2 / np.pi * np.arctan(edges / MEDIAN_SCALE_M)
    return np.asarray(np.log(np.diff(cumulative)))


def marginal_log_likelihood(log_likelihoods: np.ndarray) -> np.ndarray:
    """Integrate the scale out of log-likelihoods (..., S)."""
    return np.asarray(logsumexp(log_likelihoods + log_scale_prior(), axis=-1))


def best_scale_index(log_likelihoods: np.ndarray) -> np.ndarray:
    """Find the index of the most probable scale, given log-likelihoods (..., S)."""
    return np.asarray(np.argmax(log_likelihoods + log_scale_prior(), axis=-1))


def _kernel_root(trial: MeasuredTrial, growth: np.ndarray) -> np.ndarray:
    """Compute a root (n, R) of the discrepancy's covariance, of unit rms at the tip."""
    knots = time_nodes(trial.times, KNOT_SPACING_S)
    correlation_time = max(MATERN_TIME_S, 2 * (knots[1] - knots[0]))
    rate = np.sqrt(3) / correlation_time

    def matern(gap: np.ndarray) -> np.ndarray:
        return np.asarray((1 + rate * gap) * np.exp(-rate * gap))

    time = nystrom_root(trial.times, knots, matern)[trial.frame]
    place = place_functions(trial.s, trial.model.string.length)
    # A trial that cannot be simulated has no growth
    mean_growth = max(rms(growth), np.finfo(float).tiny)
    grown = (growth / mean_growth)[trial.frame] / trial.sigma
    in_time = grown[:, None] * time
    products = in_time[:, :, None] * place[:, None, :]
    return np.asarray(products.reshape(len(trial.s), -1))
