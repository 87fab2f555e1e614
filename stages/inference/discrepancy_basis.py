"""Smooth motion of a trial: a basis in which noise is white, turned for each onset.

A trial is expanded in smooth functions of time and place. A linear map makes noise
(`noise`) white. What the functions do not reach is noise, and gives its size.

For each onset of a discrepancy the coefficients are turned such that the discrepancy is
diagonal. Then trying a scale costs nothing. Along the string a discrepancy is a squared
exponential (0.35 L) that is zero at the grasp, and in time a Matern 3/2. It grows over
the trial as any small change of the parameters does.

Where all frames show the same places, as well, all covariances are Kronecker products
of one of place and one of time. What is turned is then only time: matrices of 300 rows
become some of 50, in a tenth of the memory.

References
----------
Saatci 2011, Scalable Inference for Structured Gaussian Process Models, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from weakref import WeakValueDictionary

import numpy as np
from scipy.linalg import eigh

from stringcast.stages.common import rms
from stringcast.stages.inference.basis import (
    KNOT_SPACING_S,
    RANK_TOLERANCE,
    SmoothFunctions,
    nystrom_root,
    place_functions,
    sum_products,
    time_nodes,
    time_splines,
)
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    sizes_by_onset,
)
from stringcast.stages.inference.noise import MeasuredTrial, Noise, gram_roots
from stringcast.stages.kept_results import content_digest

MATERN_TIME_S = 0.08  # [s]: 0.05 to 0.12 suited nine fits of strings of 0.3 m


@dataclass(frozen=True)
class OnsetBasis:
    """Coefficients in which the discrepancy of one onset is diagonal, and noise white.

    Parameters
    ----------
    rotation
        From coefficients of each block of a trial (`NoiseBasis`) to these, (m, m).
    variance
        Of a discrepancy of s = 1 m in these coefficients, (M,).
    """

    rotation: np.ndarray
    variance: np.ndarray

    def turn(self, coefficients: np.ndarray) -> np.ndarray:
        """Turn coefficients (C, 2 M) of a trial, (C, 2, M)."""
        by_block = coefficients.reshape(-1, len(self.rotation))
        turned = by_block @ self.rotation
        return np.asarray(turned.reshape(-1, 2, len(self.variance)))

    def turn_back(self, turned: np.ndarray) -> np.ndarray:
        """Turn (C, 2, M) back to coefficients of the trial, (C, 2 M)."""
        by_block = turned.reshape(-1, len(self.rotation))
        return np.asarray((by_block @ self.rotation.T).reshape(len(turned), -1))

    def variance_at(self, scale_index: int) -> np.ndarray:
        """Compute the variance of a discrepancy of a scale, (M,)."""
        return np.asarray(DISCREPANCY_SCALES_M[scale_index] ** 2 * self.variance)

    @property
    def precision_by_scale(self) -> np.ndarray:
        """The precision of discrepancy and noise together at each scale, (S, M)."""
        variance = DISCREPANCY_SCALES_M[:, None] ** 2 * self.variance
        return np.asarray(1.0 / (1.0 + variance))


@dataclass(frozen=True)
class NoiseBasis:
    """Coefficients of smooth functions in which noise is white, M of them.

    They are blocks of m that the discrepancy of any onset treats alike, but for its
    size. There is one block, or one for each function of place: where all frames show
    the same places, time and place separate.

    Parameters
    ----------
    whiten
        From sums over points of residuals over sigma times functions to coefficients,
        (M, K B).
    to_functions
        From coefficients back to factors of the functions, (K B, M).
    whiten_block
        From sums of a block to its coefficients, (m, K' B).
    gram
        Gram matrices in each frame of the functions of place of a block over sigma,
        (F, K', K').
    block_variance
        Relative variance of a discrepancy in each block, (M / m,).
    """

    whiten: np.ndarray
    to_functions: np.ndarray
    whiten_block: np.ndarray
    gram: np.ndarray
    block_variance: np.ndarray

    @classmethod
    def for_trial(cls, trial: MeasuredTrial, functions: SmoothFunctions) -> NoiseBasis:
        """Find the basis of a trial, by blocks if time and place separate."""
        gram = functions.gram_by_frame(np.ones(len(trial.s)))
        over_sigma = functions.gram_by_frame(1 / trial.sigma)
        roots = gram_roots(functions.in_place, trial.frame, len(trial.times))
        parts = (trial.noise, functions.in_time, gram, over_sigma, roots)
        if (gram == gram[0]).all() and (over_sigma == over_sigma[0]).all():
            return cls._separable(*parts) or cls._joint(*parts)
        return cls._joint(*parts)

    @classmethod
    def _joint(
        cls,
        noise: Noise,
        in_time: np.ndarray,
        gram: np.ndarray,
        over_sigma: np.ndarray,
        roots: np.ndarray,
    ) -> NoiseBasis:
        """Whiten the noise of all functions together."""
        values, vectors = eigh(noise.covariance(in_time, roots), driver="evd")
        kept = values > RANK_TOLERANCE * values[-1]
        vectors = vectors[:, kept]
        whiten = (vectors / np.sqrt(values[kept])).T
        # Coefficients of the directions that the points determine
        known = whiten @ sum_products(in_time, in_time, gram) @ vectors
        to_functions = np.linalg.solve(known.T, vectors.T).T
        return cls(whiten, to_functions, whiten, over_sigma, np.ones(1))

    @classmethod
    def _separable(
        cls,
        noise: Noise,
        in_time: np.ndarray,
        gram: np.ndarray,
        over_sigma: np.ndarray,
        roots: np.ndarray,
    ) -> NoiseBasis | None:
        """Whiten the noise in time and in place; None where points do not determine it.

        All frames show the same places: only the first of them counts.
        """
        filtered = noise.filter_in_time(in_time)
        values, vectors = eigh(filtered.T @ filtered)
        of_place = roots[0] @ noise.place_covariance @ roots[0]
        place_values = eigh(of_place, eigvals_only=True)
        smallest = values[0] * place_values[0]
        if smallest <= RANK_TOLERANCE * values[-1] * place_values[-1]:
            return None

        # Functions of place in which also the discrepancy is diagonal
        variance, axes = eigh(over_sigma[0] @ over_sigma[0].T, of_place)
        in_time_white = (vectors / np.sqrt(values)).T
        time_to_functions = np.linalg.inv(in_time_white @ in_time.T @ in_time)
        place_to_functions = np.linalg.inv(axes.T @ gram[0])
        return cls(
            np.kron(axes.T, in_time_white),
            np.kron(place_to_functions, time_to_functions),
            in_time_white,
            np.ones((len(in_time), 1, 1)),
            np.maximum(variance, 0.0),
        )


@dataclass(frozen=True, eq=False)
class DiscrepancyBasis:
    """Smooth functions of a trial, and coefficients for each onset of a discrepancy.

    It depends on times and places of the measured points and on their noise, not on
    where they are: all corrections of a trial and all hypotheses share it.

    Parameters
    ----------
    functions
        Smooth functions at the measured points, K B of them.
    noise
        In whose M coefficients noise is white.
    time_root
        A root of the discrepancy's covariance in time, (F, R).
    sizes
        Relative size of a discrepancy of each onset at each frame, (W, F).
    """

    functions: SmoothFunctions
    noise: NoiseBasis
    time_root: np.ndarray
    sizes: np.ndarray

    @classmethod
    def for_trial(cls, trial: MeasuredTrial, growth: np.ndarray) -> DiscrepancyBasis:
        """Find the basis of a trial, or make it if no discrepancy uses it yet.

        growth: relative size of a discrepancy at each frame, (F,).
        """
        noise = trial.noise
        key = content_digest(
            [
                *(trial.times, trial.frame, trial.s, trial.model.string.length),
                *(noise.place_covariance, noise.frame_correlation),
                *(trial.sigma, growth),
            ]
        )
        basis = _BASES_IN_USE.get(key)
        if basis is None:
            basis = cls._make(trial, growth)
            _BASES_IN_USE[key] = basis
        return basis

    @classmethod
    def _make(cls, trial: MeasuredTrial, growth: np.ndarray) -> DiscrepancyBasis:
        in_time = time_splines(trial.times).toarray()
        in_place = place_functions(trial.s, trial.model.string.length)
        functions = SmoothFunctions(in_time, in_place, trial.frame)
        return cls(
            functions,
            NoiseBasis.for_trial(trial, functions),
            matern_root(trial.times),
            sizes_by_onset(trial.times, growth),
        )

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n), (C, 2 M); those of x come first."""
        by_axis = self.functions.sums(residual) @ self.noise.whiten.T
        return np.asarray(by_axis.reshape(len(residual), 2 * by_axis.shape[1]))

    def at_points(self, coefficients: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Evaluate coefficients (C, 2 M) at some points, (C, 2 m).

        chosen: a mask of the m points, (n,).
        """
        by_axis = coefficients.reshape(-1, len(self.noise.whiten))
        factors = by_axis @ self.noise.to_functions.T
        return self.functions.at_points(factors, chosen)

    def at_onset(self, onset: int) -> OnsetBasis:
        """Turn the basis for an onset, once."""
        if onset not in self._by_onset:
            self._by_onset[onset] = self._turn_for(onset)
        return self._by_onset[onset]

    @cached_property
    def _by_onset(self) -> dict[int, OnsetBasis]:
        return {}

    def _turn_for(self, onset: int) -> OnsetBasis:
        size = self.sizes[onset]
        # A trial that cannot be simulated has no growth
        mean_size = max(rms(size), np.finfo(float).tiny)
        noise = self.noise
        gram = noise.gram * (size / mean_size)[:, None, None]
        sums = sum_products(self.functions.in_time, self.time_root, gram)
        root = noise.whiten_block @ sums
        variance, rotation = eigh(root @ root.T, driver="evd")
        variances = np.outer(noise.block_variance, np.maximum(variance, 0.0))
        return OnsetBasis(rotation, variances.ravel())


_BASES_IN_USE: WeakValueDictionary[str, DiscrepancyBasis] = WeakValueDictionary()


def matern_root(times: np.ndarray) -> np.ndarray:
    """Compute a root (F, R) of a discrepancy's covariance at times (F,), unit variance.

    Splines that are far apart lengthen the correlation to two of their spacings.
    """
    knots = time_nodes(times, KNOT_SPACING_S)
    correlation_time = max(MATERN_TIME_S, 2 * (knots[1] - knots[0]))
    rate = np.sqrt(3) / correlation_time

    def matern(gap: np.ndarray) -> np.ndarray:
        return np.asarray((1 + rate * gap) * np.exp(-rate * gap))

    return nystrom_root(times, knots, matern)
