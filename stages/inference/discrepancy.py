"""The discrepancy of a model in a trial: a Gaussian process.

    simulated - measured = U a + s d + e,      d ~ GP,   a ~ N(0, 1),   e: noise

The course of d and its scale s are unknown; they are on a grid (`discrepancy_grid`). In
coefficients (`discrepancy_basis`) noise is white, and for each course d is diagonal.

U has three kinds of columns, in this order: modes of the initial state, the uncertain
part of the discretisation error, and random effects of causes.

References
----------
Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425. Higdon et al. 2008, JASA 103, 570.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from stringcast.stages.inference.discrepancy_basis import CourseBasis, DiscrepancyBasis
from stringcast.stages.inference.discrepancy_grid import split_grid_point
from stringcast.stages.inference.noise import MeasuredTrial
from stringcast.stages.inference.whitening import LowRankWhitening


@dataclass(frozen=True)
class Discrepancy:
    """A model of the errors of one trial, in M coefficients for each coordinate.

    Coefficients (C, 2 M) have those of x first.

    Parameters
    ----------
    basis
        Basis of the trial.
    nuisance_coefficients
        U in coefficients, (2 M, m).
    nuisance_shapes
        U at the points over sigma, (2 n, m).
    """

    basis: DiscrepancyBasis
    nuisance_coefficients: np.ndarray
    nuisance_shapes: np.ndarray
    scale: ClassVar[float] = 1.0  # of noise over sigma

    @classmethod
    def for_trial(
        cls,
        trial: MeasuredTrial,
        growth: np.ndarray,
        nuisance: np.ndarray,
    ) -> Discrepancy:
        """Model the discrepancy of a trial.

        Parameters
        ----------
        trial
            Provides the times, arc lengths and noise of its points.
        growth
            Relative size of d at each frame, (F,).
        nuisance
            U over sigma, (2 n, m).
        """
        basis = DiscrepancyBasis.for_trial(trial, growth)
        return cls(basis, basis.coefficients(nuisance.T).T, nuisance)

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n) in the basis, (C, 2 M)."""
        return self.basis.coefficients(residual)

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
        course, scale_index = split_grid_point(grid_point)
        return self._errors_by_course[course].whiten(coefficients, scale_index)

    def log_likelihood_by_grid_point(self, coefficients: np.ndarray) -> np.ndarray:
        """Compute the log-likelihood of coefficients (C, 2 M), (C, W S)."""
        by_course = []
        for errors in self._errors_by_course:
            by_course.append(errors.log_likelihood_by_scale(coefficients))
        return np.concatenate(by_course, axis=1)

    def log_likelihood_by_nuisance_size(
        self, coefficients: np.ndarray, sizes: np.ndarray
    ) -> np.ndarray:
        """Compute the log-likelihood with other sizes of the nuisance, (L, C, W S).

        coefficients: (C, 2 M). sizes: factors of U, (L, m).
        """
        by_course = []
        for errors in self._errors_by_course:
            by_course.append(errors.log_likelihood_by_size(coefficients, sizes))
        return np.concatenate(by_course, axis=2)

    def posterior_mean(self, coefficients: np.ndarray, grid_point: int) -> np.ndarray:
        """Compute the most likely discrepancy over sigma, (2 n,).

        coefficients: those of the residual, (2 M,).
        """
        everywhere = np.ones(len(self.nuisance_shapes) // 2, dtype=bool)
        return self._mean_at_points(coefficients, grid_point, everywhere)

    def sample_posterior(
        self,
        coefficients: np.ndarray,
        grid_point: int,
        count: int,
        rng: np.random.Generator,
        chosen: np.ndarray,
    ) -> np.ndarray:
        """Draw discrepancies over sigma (count, 2 q) from their posterior.

        Parameters
        ----------
        coefficients
            Those of the residual, (2 M,).
        grid_point
            Course and scale of the discrepancy.
        count
            Number of draws.
        rng
            Generator of the draws.
        chosen
            A mask of q points at which they are evaluated, (n,).
        """
        course, scale_index = split_grid_point(grid_point)
        variance = self.basis.by_course[course].variance_at(scale_index)
        normal = rng.standard_normal((count, 2, len(variance)))
        scatter = normal * np.sqrt(variance / (1.0 + variance))
        offset = self._at_points(scatter, course, chosen)
        mean = self._mean_at_points(coefficients, grid_point, chosen)
        return np.asarray(mean + offset)

    def nuisance_mean(self, coefficients: np.ndarray, grid_point: int) -> np.ndarray:
        """Compute the most likely nuisance U a over sigma, (2 n,).

        coefficients: those of the residual, (2 M,).
        """
        amplitudes = self._nuisance_amplitudes(coefficients, grid_point)
        return np.asarray(self.nuisance_shapes @ amplitudes)

    def _mean_at_points(
        self, coefficients: np.ndarray, grid_point: int, chosen: np.ndarray
    ) -> np.ndarray:
        course, scale_index = split_grid_point(grid_point)
        basis = self.basis.by_course[course]
        variance = basis.variance_at(scale_index)
        amplitudes = self._nuisance_amplitudes(coefficients, grid_point)
        explained = self.nuisance_coefficients @ amplitudes
        rotated = basis.rotate((coefficients - explained)[None])
        smooth = rotated * variance / (1.0 + variance)
        return np.asarray(self._at_points(smooth, course, chosen)[0])

    def _at_points(
        self, rotated: np.ndarray, course: int, chosen: np.ndarray
    ) -> np.ndarray:
        """Evaluate rotated coefficients (C, 2, M) at some points, (C, 2 q)."""
        coefficients = self.basis.by_course[course].rotate_back(rotated)
        return self.basis.at_points(coefficients, chosen)

    def _nuisance_amplitudes(
        self, coefficients: np.ndarray, grid_point: int
    ) -> np.ndarray:
        course, scale_index = split_grid_point(grid_point)
        return self._errors_by_course[course].nuisance_amplitudes(
            coefficients, scale_index
        )

    @cached_property
    def _errors_by_course(self) -> tuple[_ErrorsOfCourse, ...]:
        columns = self.nuisance_coefficients
        return tuple(_ErrorsOfCourse(basis, columns) for basis in self.basis.by_course)


class _ErrorsOfCourse:
    """The errors of a trial whose discrepancy has a known course.

    At each scale V = D + U U', with D diagonal in rotated coefficients. The likelihood
    follows from the Woodbury identity and the determinant lemma (Harville 1997, Matrix
    Algebra From a Statistician's Perspective, 18.1-2).

    Attributes
    ----------
    nuisance : numpy.ndarray, shape (m, 2, M)
        U in rotated coefficients.
    """

    def __init__(self, basis: CourseBasis, nuisance_coefficients: np.ndarray) -> None:
        self.basis = basis
        self.nuisance = basis.rotate(nuisance_coefficients.T)
        self._whitenings: dict[int, tuple[np.ndarray, LowRankWhitening]] = {}

    def whiten(self, coefficients: np.ndarray, scale_index: int) -> np.ndarray:
        """Compute V^(-1/2) of coefficients (C, 2 M)."""
        if scale_index not in self._whitenings:
            variance = np.tile(self.basis.variance_at(scale_index), 2)
            deviation = np.sqrt(1.0 + variance)  # (2 M,)
            columns = self.nuisance.reshape(-1, len(deviation)).T / deviation[:, None]
            whitening = LowRankWhitening.from_columns(columns)
            self._whitenings[scale_index] = (deviation, whitening)
        deviation, whitening = self._whitenings[scale_index]
        rotated = self.basis.rotate(coefficients).reshape(coefficients.shape)
        return whitening(rotated / deviation)

    def log_likelihood_by_scale(self, coefficients: np.ndarray) -> np.ndarray:
        """Compute the log-likelihood of coefficients (C, 2 M) at each scale, (C, S)."""
        return self._log_likelihoods(coefficients, [self._nuisance_terms])[0]

    def log_likelihood_by_size(
        self, coefficients: np.ndarray, sizes: np.ndarray
    ) -> np.ndarray:
        """Compute the log-likelihood with other sizes of U, (L, C, S).

        coefficients: (C, 2 M). sizes: factors of U, (L, m).
        """
        terms = [self._nuisance_terms_at(size) for size in sizes]
        return self._log_likelihoods(coefficients, terms)

    def _log_likelihoods(
        self,
        coefficients: np.ndarray,
        nuisance_terms: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> np.ndarray:
        """Compute the log-likelihood with each of L `_nuisance_terms`, (L, C, S)."""
        precision = self.basis.precision_by_scale  # of D, (S, M)
        rotated = self.basis.rotate(coefficients)  # (C, 2, M)
        square = np.sum(rotated**2, axis=1) @ precision.T  # c' D^-1 c, (C, S)
        projected = self._project(rotated, precision).transpose(2, 0, 1)  # (S, C, m)
        log_likelihoods = []
        for covariance, log_determinant in nuisance_terms:
            explained = np.sum((projected @ covariance) * projected, axis=2)  # (S, C)
            log_likelihoods.append(-0.5 * (square - explained.T + log_determinant))
        return np.stack(log_likelihoods)

    def nuisance_amplitudes(
        self, coefficients: np.ndarray, scale_index: int
    ) -> np.ndarray:
        """Compute the most likely amplitudes of U given coefficients (2 M,), (m,)."""
        precision = self.basis.precision_by_scale[[scale_index]]
        rotated = self.basis.rotate(coefficients[None])
        projected = self._project(rotated, precision)[0, :, 0]
        covariance, _ = self._nuisance_terms
        return np.asarray(covariance[scale_index] @ projected)

    def _project(self, rotated: np.ndarray, precision: np.ndarray) -> np.ndarray:
        """Compute U' D^-1 c of rotated coefficients c (C, 2, M) by scale, (C, m, S)."""
        x, y = rotated[:, None, 0], rotated[:, None, 1]
        products = x * self.nuisance[:, 0] + y * self.nuisance[:, 1]  # (C, m, M)
        sums = products.reshape(-1, products.shape[2]) @ precision.T
        return np.asarray(sums.reshape(*products.shape[:2], len(precision)))

    @cached_property
    def _nuisance_terms(self) -> tuple[np.ndarray, np.ndarray]:
        """The nuisance's terms of the likelihood at each scale.

        The posterior covariance (1 + U' D^-1 U)^-1 (S, m, m) of the amplitudes, and ln
        |V| (S,).
        """
        return self._nuisance_terms_at(np.ones(len(self.nuisance)))

    def _nuisance_terms_at(self, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the terms with other sizes of U, relative to the present ones, (m,).

        Amplitudes are in units of the present U.
        """
        factors = np.outer(size, size)
        information = factors * self._nuisance_products + np.eye(len(size))
        log_determinant = -2 * np.log(self.basis.precision_by_scale).sum(axis=1)
        log_determinant += np.linalg.slogdet(information)[1]
        return factors * np.linalg.inv(information), log_determinant

    @cached_property
    def _nuisance_products(self) -> np.ndarray:
        """U' D^-1 U at each scale, (S, m, m)."""
        precision = self.basis.precision_by_scale
        return self._project(self.nuisance, precision).transpose(2, 0, 1)
