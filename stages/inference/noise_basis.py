"""Coefficients of a trial's smooth motion in which its noise is white.

Noise outside the span of these functions is not expanded: its size is estimated
before (`noise`). A basis has M coefficients for each coordinate, in uncorrelated blocks
of m. The covariance of a discrepancy differs between blocks only by a factor,
`block_variance`.

If all frames show the same places, the covariances of noise and discrepancy are
Kronecker products of a matrix for place and one for time. These have at most 6 and some
60 rows and replace one of 300.

References
----------
Saatci 2011, Scalable Inference for Structured Gaussian Process Models, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from stringcast.stages.inference.basis import (
    RANK_TOLERANCE,
    SmoothFunctions,
    place_functions,
    sum_products,
    time_splines,
)
from stringcast.stages.inference.noise import MeasuredTrial, Noise, gram_roots


@dataclass(frozen=True)
class JointNoiseBasis:
    """A single block of all functions of time and place.

    Parameters
    ----------
    functions
        Smooth functions at the measured points, K B of them.
    whiten
        Maps the scalar products of residuals and functions to coefficients, (M, K B).
    to_functions
        Maps coefficients to factors of the functions, (K B, M).
    gram
        Gram matrices of the functions of place over sigma in each frame, (F, K, K).
    """

    functions: SmoothFunctions
    whiten: np.ndarray
    to_functions: np.ndarray
    gram: np.ndarray

    @classmethod
    def for_noise(
        cls,
        noise: Noise,
        functions: SmoothFunctions,
        gram: np.ndarray,
        gram_over_sigma: np.ndarray,
    ) -> JointNoiseBasis:
        """Whiten noise in the directions that the points determine.

        gram, gram_over_sigma: Gram matrices of the functions of place, (F, K, K).
        """
        in_time = functions.in_time
        covariance = noise.covariance(in_time, gram_roots(gram))
        values, vectors = eigh(covariance, driver="evd")
        kept = values > RANK_TOLERANCE * values[-1]
        vectors = vectors[:, kept]
        whiten = (vectors / np.sqrt(values[kept])).T
        known = whiten @ sum_products(in_time, in_time, gram) @ vectors
        to_functions = np.linalg.solve(known.T, vectors.T).T
        return cls(functions, whiten, to_functions, gram_over_sigma)

    @property
    def block_variance(self) -> np.ndarray:
        """The relative variance of a discrepancy in the only block, (1,)."""
        return np.ones(1)

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n), (2 C, M).

        The rows of a candidate are those of x and y.
        """
        return np.asarray(self.functions.sums(residual) @ self.whiten.T)

    def at_points(self, coefficients: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Evaluate coefficients (2 C, M) at some points, (C, 2 q).

        chosen: a mask of the q points, (n,).
        """
        factors = coefficients @ self.to_functions.T
        return self.functions.at_points(factors, chosen)

    def discrepancy_root(self, time_root: np.ndarray) -> np.ndarray:
        """Compute a root of a discrepancy's covariance, (M, K R).

        time_root: a root of its covariance at the frames, (F, R).
        """
        sums = sum_products(self.functions.in_time, time_root, self.gram)
        return np.asarray(self.whiten @ sums)


@dataclass(frozen=True)
class SeparableNoiseBasis:
    """A block for each function of place, if all frames show the same places.

    Parameters
    ----------
    white
        M functions whose scalar products with residuals are the coefficients.
    dual
        Functions whose factors are the coefficients.
    block_variance
        The relative variance of a discrepancy in each block, (K,).
    """

    white: SmoothFunctions
    dual: SmoothFunctions
    block_variance: np.ndarray

    @classmethod
    def for_noise(
        cls,
        noise: Noise,
        functions: SmoothFunctions,
        gram: np.ndarray,
        gram_over_sigma: np.ndarray,
    ) -> SeparableNoiseBasis | None:
        """Whiten noise in time and in place; None if points do not determine it.

        gram, gram_over_sigma: Gram matrices of the functions of place, (K, K).
        """
        in_time = functions.in_time
        filtered = noise.filter_in_time(in_time)
        values, vectors = eigh(filtered.T @ filtered)
        (root,) = gram_roots(gram[None])
        of_place = root @ noise.place_covariance @ root
        place_values = eigh(of_place, eigvals_only=True)
        smallest = values[0] * place_values[0]
        if smallest <= RANK_TOLERANCE * values[-1] * place_values[-1]:
            return None

        # Choose functions of place that are white and make the discrepancy diagonal
        variance, axes = eigh(gram_over_sigma @ gram_over_sigma.T, of_place)
        in_place = functions.in_place @ axes
        place_gram = axes.T @ gram @ axes
        white_time = in_time @ (vectors / np.sqrt(values))
        dual_time = np.linalg.solve(white_time.T @ white_time, white_time.T).T
        dual_place = np.linalg.solve(place_gram, in_place.T).T
        return cls(
            SmoothFunctions(white_time, in_place, functions.frame),
            SmoothFunctions(dual_time, dual_place, functions.frame),
            np.maximum(variance, 0.0),
        )

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n), (2 C, M)."""
        return self.white.sums(residual)

    def at_points(self, coefficients: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Evaluate coefficients (2 C, M) at some points, (C, 2 q)."""
        return self.dual.at_points(coefficients, chosen)

    def discrepancy_root(self, time_root: np.ndarray) -> np.ndarray:
        """Compute a root of a discrepancy's covariance in a block, (m, R)."""
        return np.asarray(self.white.in_time.T @ time_root)


NoiseBasis = JointNoiseBasis | SeparableNoiseBasis


def find_noise_basis(trial: MeasuredTrial) -> NoiseBasis:
    """Find the basis of a trial, in blocks if time and place separate."""
    in_time = time_splines(trial.times)
    in_place = place_functions(trial.s, trial.model.string.length)
    functions = SmoothFunctions(in_time, in_place, trial.frame)
    gram = functions.gram_by_frame(np.ones(len(trial.s)))
    over_sigma = functions.gram_by_frame(1 / trial.sigma)
    if (gram == gram[0]).all() and (over_sigma == over_sigma[0]).all():
        separable = SeparableNoiseBasis.for_noise(
            trial.noise, functions, gram[0], over_sigma[0]
        )
        if separable is not None:
            return separable
    return JointNoiseBasis.for_noise(trial.noise, functions, gram, over_sigma)
