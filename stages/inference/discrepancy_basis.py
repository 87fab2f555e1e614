"""Coefficients of a trial in which noise is white and the discrepancy is diagonal.

In coefficients of smooth functions noise is white (`noise_basis`). For each course they
are rotated so that the covariance of the discrepancy is diagonal. The likelihood at
another scale then costs almost nothing. The kernel of the discrepancy is a squared
exponential along the string (0.35 L), zero at the grasp, and a Matern 3/2 in time. Its
size over the trial is that of its course.
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
    nystrom_root,
    time_nodes,
)
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    sizes_by_course,
)
from stringcast.stages.inference.noise import MeasuredTrial
from stringcast.stages.inference.noise_basis import NoiseBasis, find_noise_basis
from stringcast.stages.kept_results import content_digest

MATERN_TIME_S = 0.08  # 0.05 to 0.12 s fit nine residuals of strings of 0.3 m


@dataclass(frozen=True)
class CourseBasis:
    """Coefficients in which noise is white and one course's discrepancy is diagonal.

    Parameters
    ----------
    rotation
        Rotation of each block's coefficients (`NoiseBasis`) into these, (m, m).
    variance
        Variance in these coefficients of a discrepancy with s = 1 m, (M,).
    """

    rotation: np.ndarray
    variance: np.ndarray

    def rotate(self, coefficients: np.ndarray) -> np.ndarray:
        """Rotate coefficients (C, 2 M) of a trial, (C, 2, M)."""
        by_block = coefficients.reshape(-1, len(self.rotation))
        rotated = by_block @ self.rotation
        return np.asarray(rotated.reshape(-1, 2, len(self.variance)))

    def rotate_back(self, rotated: np.ndarray) -> np.ndarray:
        """Rotate (C, 2, M) back to coefficients of the trial, (C, 2 M)."""
        by_block = rotated.reshape(-1, len(self.rotation))
        return np.asarray((by_block @ self.rotation.T).reshape(len(rotated), -1))

    def variance_at(self, scale_index: int) -> np.ndarray:
        """Compute the variance of a discrepancy at a scale, (M,)."""
        return np.asarray(DISCREPANCY_SCALES_M[scale_index] ** 2 * self.variance)

    @cached_property
    def precision_by_scale(self) -> np.ndarray:
        """The precision of discrepancy plus noise at each scale, (S, M)."""
        variance = DISCREPANCY_SCALES_M[:, None] ** 2 * self.variance
        return np.asarray(1.0 / (1.0 + variance))


@dataclass(frozen=True, eq=False)
class DiscrepancyBasis:
    """Smooth functions of a trial, and coefficients for each course of a discrepancy.

    It depends on the times, arc lengths and noise of the points, not on their measured
    positions. So all corrections of a trial and all hypotheses share it.

    Parameters
    ----------
    noise_basis
        M coefficients in which noise is white.
    time_root
        A root of the discrepancy's covariance in time, (F, R).
    sizes
        Relative size of a discrepancy at each frame for each course, (W, F).
    """

    noise_basis: NoiseBasis
    time_root: np.ndarray
    sizes: np.ndarray

    @classmethod
    def for_trial(cls, trial: MeasuredTrial, growth: np.ndarray) -> DiscrepancyBasis:
        """Find the basis of a trial, or make it if none is in use.

        growth: relative size of a discrepancy at each frame, (F,).
        """
        noise = trial.noise
        points = [trial.times, trial.frame, trial.s, trial.model.string.length]
        correlations = [noise.place_covariance, noise.frame_correlation]
        key = content_digest([*points, *correlations, trial.sigma, growth])
        basis = _BASES_IN_USE.get(key)
        if basis is None:
            sizes = sizes_by_course(trial.times, growth)
            basis = cls(find_noise_basis(trial), matern_root(trial.times), sizes)
            _BASES_IN_USE[key] = basis
        return basis

    def coefficients(self, residual: np.ndarray) -> np.ndarray:
        """Expand residuals over sigma (C, 2 n), (C, 2 M); those of x come first."""
        by_axis = self.noise_basis.coefficients(residual)
        return np.asarray(by_axis.reshape(len(residual), 2 * by_axis.shape[1]))

    def at_points(self, coefficients: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Evaluate coefficients (C, 2 M) at some points, (C, 2 q).

        chosen: a mask of the q points, (n,).
        """
        by_axis = coefficients.reshape(2 * len(coefficients), -1)
        return self.noise_basis.at_points(by_axis, chosen)

    @cached_property
    def by_course(self) -> tuple[CourseBasis, ...]:
        """The rotated coefficients for each course, W of them."""
        return tuple(self._basis_for_size(size) for size in self.sizes)

    def _basis_for_size(self, size: np.ndarray) -> CourseBasis:
        """Rotate coefficients for a discrepancy of a size at each frame, (F,)."""
        # Growth is zero in a trial whose simulation diverges
        unit_size = size / max(rms(size), np.finfo(float).tiny)
        time_root = unit_size[:, None] * self.time_root  # (F, R)
        root = self.noise_basis.discrepancy_root(time_root)
        variance, rotation = eigh(root @ root.T, driver="evd")  # (m,), (m, m)
        block_variance = self.noise_basis.block_variance
        variances = np.outer(block_variance, np.maximum(variance, 0.0))
        return CourseBasis(rotation, variances.ravel())


_BASES_IN_USE: WeakValueDictionary[str, DiscrepancyBasis] = WeakValueDictionary()


def matern_root(times: np.ndarray) -> np.ndarray:
    """Compute a root (F, R) of a discrepancy's correlation at times (F,).

    The correlation time is at least two knot spacings.
    """
    knots = time_nodes(times, KNOT_SPACING_S)
    correlation_time = max(MATERN_TIME_S, 2 * (knots[1] - knots[0]))
    rate = np.sqrt(3) / correlation_time

    def matern(gap: np.ndarray) -> np.ndarray:
        return np.asarray((1 + rate * gap) * np.exp(-rate * gap))

    return nystrom_root(times, knots, matern)
