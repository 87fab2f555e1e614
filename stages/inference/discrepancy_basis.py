"""Smooth motion of a trial: a basis in which noise is white, turned for each onset.

A trial is expanded in smooth functions of time and place. A linear map makes noise
(`noise`) white. What the functions do not reach is noise, and gives its size.

For each onset of a discrepancy the coefficients are turned such that the discrepancy is
diagonal. Then trying a scale costs nothing. Along the string a discrepancy is a squared
exponential (0.35 L) that is zero at the grasp, and in time a Matern 3/2. It grows over
the trial as any small change of the parameters does.
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
    time_nodes,
    time_splines,
)
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    sizes_by_onset,
)
from stringcast.stages.inference.noise import MeasuredTrial, gram_roots
from stringcast.stages.kept_results import content_digest

MATERN_TIME_S = 0.08  # [s]: 0.05 to 0.12 suited nine fits of strings of 0.3 m


@dataclass(frozen=True)
class OnsetBasis:
    """Coefficients in which the discrepancy of one onset is diagonal, and noise white.

    Parameters
    ----------
    rotation
        From coefficients of the trial to these, (M, M).
    variance
        Of a discrepancy of s = 1 m in these coefficients, (M,).
    """

    rotation: np.ndarray
    variance: np.ndarray

    def turn(self, coefficients: np.ndarray) -> np.ndarray:
        """Turn coefficients (C, 2 M) of a trial, (C, 2, M)."""
        by_axis = coefficients.reshape(-1, len(self.rotation))
        return (by_axis @ self.rotation).reshape(-1, 2, len(self.rotation))

    def turn_back(self, turned: np.ndarray) -> np.ndarray:
        """Turn (C, 2, M) back to coefficients of the trial, (2 C, M)."""
        by_axis = turned.reshape(-1, len(self.rotation))
        return np.asarray(by_axis @ self.rotation.T)

    def variance_at(self, scale_index: int) -> np.ndarray:
        """Compute the variance of a discrepancy of a scale, (M,)."""
        return np.asarray(DISCREPANCY_SCALES_M[scale_index] ** 2 * self.variance)

    @property
    def precision_by_scale(self) -> np.ndarray:
        """The precision of discrepancy and noise together at each scale, (S, M)."""
        variance = DISCREPANCY_SCALES_M[:, None] ** 2 * self.variance
        return np.asarray(1.0 / (1.0 + variance))


@dataclass(frozen=True, eq=False)
class DiscrepancyBasis:
    """Smooth functions of a trial, and M coefficients of them in which noise is white.

    It depends on times and places of the measured points and on their noise, not on
    where they are: all corrections of a trial and all hypotheses share it.

    Parameters
    ----------
    functions
        Smooth functions at the measured points, K B of them.
    whiten
        From sums over points of residuals over sigma times functions to coefficients,
        (M, K B).
    to_functions
        From coefficients back to factors of the functions, (K B, M).
    time_root
        A root of the discrepancy's covariance in time, (F, R).
    sizes
        Relative size of a discrepancy of each onset at each frame, (W, F).
    gram
        Gram matrices of the functions of place over sigma in each frame, (F, K, K).
    """

    functions: SmoothFunctions
    whiten: np.ndarray
    to_functions: np.ndarray
    time_root: np.ndarray
    sizes: np.ndarray
    gram: np.ndarray

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
        splines = time_splines(trial.times)
        place = place_functions(trial.s, trial.model.string.length)
        functions = SmoothFunctions(splines.toarray(), place, trial.frame)
        roots = gram_roots(place, trial.frame, len(trial.times))
        values, vectors = eigh(trial.noise.covariance(splines, roots), driver="evd")
        kept = values > RANK_TOLERANCE * values[-1]
        vectors = vectors[:, kept]
        whiten = (vectors / np.sqrt(values[kept])).T
        # Coefficients of the directions that the points determine
        gram = functions.gram_by_frame(np.ones(len(trial.s)))
        sums = functions.products_with(functions.in_time, gram)
        to_functions = np.linalg.solve((whiten @ sums @ vectors).T, vectors.T).T
        return cls(
            functions,
            whiten,
            to_functions,
            matern_root(trial.times),
            sizes_by_onset(trial.times, growth),
            functions.gram_by_frame(1 / trial.sigma),
        )

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n), (C, 2 M); those of x come first."""
        by_axis = self.functions.sums(residual) @ self.whiten.T
        return np.asarray(by_axis.reshape(len(residual), 2 * len(self.whiten)))

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
        gram = self.gram * (size / mean_size)[:, None, None]
        root = self.whiten @ self.functions.products_with(self.time_root, gram)
        variance, rotation = eigh(root @ root.T, driver="evd")
        return OnsetBasis(rotation, np.maximum(variance, 0.0))


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
