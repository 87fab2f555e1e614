"""The discrepancy of a model in a trial: a Gaussian process.

    simulated - measured = U a + s d + e,      d ~ GP,   a ~ N(0, 1),   e: noise

d is zero at the grasp, smooth along the string (squared exponential, 0.35 L) and in
time (Matern 3/2), and grows over the trial as any small change of the parameters does.
When it begins in a trial, and its scale s, are unknown: they are on a grid
(`discrepancy_grid`). U are the modes of the trial's initial state.

A trial is expanded in a basis of smooth functions of time and place in which noise
(`noise`) is white. Turned for an onset, the discrepancy is diagonal in it, and trying a
scale costs nothing. What the basis does not reach is noise, and gives its size.

U has three kinds of columns, in this order: modes of the initial state, the uncertain
part of the discretisation error, and random effects of causes.

References
----------
Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425. Higdon et al. 2008, JASA 103, 570.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array

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
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    ONSET_SHARES,
    sizes_by_onset,
    split_grid_point,
)
from stringcast.stages.inference.noise import MeasuredTrial, gram_roots
from stringcast.stages.inference.whitening import LowRankWhitening

MATERN_TIME_S = 0.08  # [s]: 0.05 to 0.12 suited nine fits of strings of 0.3 m
# of all numbers: fewer beyond what splines reach do not give the noise
MIN_FREE_SHARE = 0.2
MAX_KEPT_TRIALS = 64  # some 3 and 8 MB each, in two caches


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
    to_splines
        From coefficients back to splines, (B, M).
    """

    splines: csr_array
    whiten: np.ndarray
    to_splines: np.ndarray

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
        values, vectors = eigh(trial.noise.covariance(time, roots), driver="evd")
        kept = values > RANK_TOLERANCE * values[-1]
        vectors = vectors[:, kept]
        whiten = (vectors / np.sqrt(values[kept])).T
        # Coefficients of the directions that the points determine
        gram = whiten @ (splines.T @ splines).toarray() @ vectors
        to_splines = np.linalg.solve(gram.T, vectors.T).T
        return cls(splines, whiten, to_splines)


def _basis_parts(trial: MeasuredTrial) -> list[np.ndarray]:
    """List all that decides the basis of a trial."""
    noise = trial.noise
    numbers = np.array([trial.model.string.length, noise.frame_correlation])
    return [trial.times, trial.frame, trial.s, noise.place_covariance, numbers]


_KEPT_BASES: ContentCache[NoiseBasis] = ContentCache(MAX_KEPT_TRIALS)


@dataclass(frozen=True)
class Discrepancy:
    """The discrepancy of one trial, in M coefficients for each coordinate.

    Coefficients (C, 2 M) hold those of x first. Noise is white in them. Turned by the
    rotation of an onset, the discrepancy is diagonal.

    Parameters
    ----------
    splines
        Basis functions at the measured points, (n, B).
    to_coefficients
        From sums over points of residuals over sigma times splines to coefficients, (M,
        B).
    to_splines
        From coefficients back to splines, (B, M).
    rotation
        Of coefficients for each onset, (W, M, M).
    variance
        Of turned coefficients of a discrepancy of s = 1 m, (W, M).
    precision
        D^-1, of turned coefficients without nuisance at each scale, (W, S, 2 M).
    nuisance_coefficients
        U in coefficients, (2 M, m).
    nuisance_shapes
        U at the points over sigma, (2 n, m).
    """

    splines: csr_array
    to_coefficients: np.ndarray
    to_splines: np.ndarray
    rotation: np.ndarray
    variance: np.ndarray
    precision: np.ndarray
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
        """Find the basis of a trial, and how it is turned for each onset.

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
        variances = []
        rotations = []
        for root in _kernel_roots(trial, sizes_by_onset(trial.times, growth)):
            smooth_root = basis.whiten @ (basis.splines.T @ root)
            variance, rotation = eigh(smooth_root @ smooth_root.T, driver="evd")
            variances.append(np.maximum(variance, 0.0))
            rotations.append(rotation)
        variance = np.stack(variances)
        by_scale = DISCREPANCY_SCALES_M[:, None] ** 2 * variance[:, None]  # (W, S, M)
        return cls(
            basis.splines,
            to_coefficients=basis.whiten,
            to_splines=basis.to_splines,
            rotation=np.stack(rotations),
            variance=variance,
            precision=np.tile(1.0 / (1.0 + by_scale), 2),
            nuisance_coefficients=np.zeros((2 * len(basis.whiten), 0)),
            nuisance_shapes=np.zeros((2 * len(trial.s), 0)),
        )

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n) in the basis, (C, 2 M)."""
        count = len(residual)
        points = self.splines.shape[0]
        by_point = residual.reshape(count, points, 2).transpose(1, 0, 2)
        sums = self.splines.T @ by_point.reshape(points, 2 * count)
        by_basis = self.to_coefficients @ sums  # (M, 2 C)
        return np.ascontiguousarray(by_basis.T).reshape(count, 2 * len(by_basis))

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

    def whiten(self, residual: np.ndarray, grid_point: int) -> np.ndarray:
        """Compute V^(-1/2) of residuals over sigma (C, 2 n), (C, 2 M)."""
        return self.whiten_coefficients(self.coefficients(residual), grid_point)

    def whiten_coefficients(
        self, coefficients: np.ndarray, grid_point: int
    ) -> np.ndarray:
        """Compute V^(-1/2) of coefficients (C, 2 M)."""
        onset, _ = split_grid_point(grid_point)
        if grid_point not in self._whitenings:
            deviation = np.sqrt(1.0 + self._variance_of(grid_point))
            columns = self._turned_nuisance[onset] / deviation[:, None]
            whitening = LowRankWhitening.from_columns(columns)
            self._whitenings[grid_point] = (deviation, whitening)
        deviation, whitening = self._whitenings[grid_point]
        return whitening(self._turn(coefficients, onset) / deviation)

    def log_likelihood_by_grid_point(self, coefficients: np.ndarray) -> np.ndarray:
        """Compute the log-likelihood of coefficients (C, 2 M), (C, W S).

        With V = D + U U', by the Woodbury identity and the determinant lemma
        (Harville 1997, Matrix Algebra From a Statistician's Perspective, 18.1-2).
        """
        by_onset = []
        for onset, nuisance in enumerate(self._turned_nuisance):
            precision = self.precision[onset]
            covariance, log_determinant = self._nuisance_by_onset[onset]
            turned = self._turn(coefficients, onset)
            square = turned**2 @ precision.T  # (C, S)
            projected = turned @ (precision[:, :, None] * nuisance)  # (S, C, m)
            explained = np.sum((projected @ covariance) * projected, axis=2)
            by_onset.append(-0.5 * (square - explained.T + log_determinant))
        return np.concatenate(by_onset, axis=1)

    def posterior_mean(self, coefficients: np.ndarray, grid_point: int) -> np.ndarray:
        """Compute the most likely discrepancy over sigma, (2 n,).

        coefficients: of the residual, (2 M,).
        """
        onset, _ = split_grid_point(grid_point)
        variance = self._variance_of(grid_point)
        amplitudes = self._nuisance_amplitudes(coefficients, grid_point)
        explained = self.nuisance_coefficients @ amplitudes
        turned = self._turn((coefficients - explained)[None], onset)
        smooth = turned * variance / (1.0 + variance)
        return np.asarray((self.splines @ self._to_splines(smooth, onset)).ravel())

    def sample_posterior(
        self,
        coefficients: np.ndarray,
        grid_point: int,
        count: int,
        rng: np.random.Generator,
        chosen: np.ndarray,
    ) -> np.ndarray:
        """Draw discrepancies over sigma (count, 2 m) given coefficients (2 M,).

        chosen: a mask of the m points at which they are wanted, (n,).
        """
        onset, _ = split_grid_point(grid_point)
        variance = self._variance_of(grid_point)
        normal = rng.standard_normal((count, len(variance)))
        scatter = normal * np.sqrt(variance / (1.0 + variance))
        by_spline = self._to_splines(scatter, onset)
        by_point = (self.splines[chosen] @ by_spline).reshape(-1, count, 2)
        offset = by_point.transpose(1, 0, 2).reshape(count, -1)
        mean = self.posterior_mean(coefficients, grid_point)
        return np.asarray(mean[np.repeat(chosen, 2)] + offset)

    def nuisance_mean(self, coefficients: np.ndarray, grid_point: int) -> np.ndarray:
        """Compute what the nuisance most likely explains of coefficients, (2 n,)."""
        amplitudes = self._nuisance_amplitudes(coefficients, grid_point)
        return np.asarray(self.nuisance_shapes @ amplitudes)

    def _nuisance_amplitudes(
        self, coefficients: np.ndarray, grid_point: int
    ) -> np.ndarray:
        onset, scale_index = split_grid_point(grid_point)
        covariance, _ = self._nuisance_by_onset[onset]
        turned = self._turn(coefficients[None], onset)[0]
        weighted = self.precision[onset, scale_index] * turned
        projected = weighted @ self._turned_nuisance[onset]
        return np.asarray(covariance[scale_index] @ projected)

    def _turn(self, coefficients: np.ndarray, onset: int) -> np.ndarray:
        """Turn coefficients (C, 2 M) to those in which a discrepancy is diagonal."""
        by_axis = coefficients.reshape(-1, len(self.to_coefficients))
        return np.asarray((by_axis @ self.rotation[onset]).reshape(coefficients.shape))

    def _to_splines(self, turned: np.ndarray, onset: int) -> np.ndarray:
        """Turn coefficients of an onset (C, 2 M) back to splines, (B, 2 C)."""
        by_axis = turned.reshape(-1, len(self.to_coefficients))
        return np.asarray(self.to_splines @ (self.rotation[onset] @ by_axis.T))

    def _variance_of(self, grid_point: int) -> np.ndarray:
        """Look up the variance of turned coefficients in a grid point, (2 M,)."""
        onset, scale_index = split_grid_point(grid_point)
        scale_m = DISCREPANCY_SCALES_M[scale_index]
        return np.tile(scale_m**2 * self.variance[onset], 2)

    @cached_property
    def _turned_nuisance(self) -> list[np.ndarray]:
        """U in turned coefficients of each onset, (2 M, m)."""
        rows = self.nuisance_coefficients.T
        return [self._turn(rows, onset).T for onset in range(len(ONSET_SHARES))]

    @cached_property
    def _whitenings(self) -> dict[int, tuple[np.ndarray, LowRankWhitening]]:
        """Deviations (2 M,) without nuisance and the rest of V, by grid point."""
        return {}

    @cached_property
    def _nuisance_by_onset(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Terms of the likelihood with the nuisance, for each onset.

        At each scale: the covariance (1 + U' D^-1 U)^-1 (S, m, m) of the nuisance's
        amplitudes given the data, and ln |V| (S,).
        """
        by_onset = []
        for precision, nuisance in zip(
            self.precision, self._turned_nuisance, strict=True
        ):
            information = (nuisance.T * precision[:, None]) @ nuisance
            information += np.eye(nuisance.shape[1])
            log_determinant = -np.log(precision).sum(axis=1)
            log_determinant += np.linalg.slogdet(information)[1]
            by_onset.append((np.linalg.inv(information), log_determinant))
        return by_onset


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


def _kernel_roots(trial: MeasuredTrial, sizes: np.ndarray) -> Iterator[np.ndarray]:
    """Compute roots (n, R) of the discrepancy's covariance, of unit rms at the tip.

    sizes: relative ones at each frame, (W, F), for each of which there is a root.
    """
    knots = time_nodes(trial.times, KNOT_SPACING_S)
    correlation_time = max(MATERN_TIME_S, 2 * (knots[1] - knots[0]))
    rate = np.sqrt(3) / correlation_time

    def matern(gap: np.ndarray) -> np.ndarray:
        return np.asarray((1 + rate * gap) * np.exp(-rate * gap))

    time = nystrom_root(trial.times, knots, matern)[trial.frame]
    place = place_functions(trial.s, trial.model.string.length)
    for size in sizes:
        # A trial that cannot be simulated has no growth
        mean_size = max(rms(size), np.finfo(float).tiny)
        at_points = (size / mean_size)[trial.frame] / trial.sigma
        in_time = at_points[:, None] * time
        products = in_time[:, :, None] * place[:, None, :]
        yield np.asarray(products.reshape(len(trial.s), -1))
