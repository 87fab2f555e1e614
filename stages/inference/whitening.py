"""Error models of a trial, and the whitening of residuals by them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class LowRankWhitening:
    """The whitening of a covariance 1 + U U'.

    V^(-1/2) r = r - Q (1 - (1 + s^2)^(-1/2)) Q' r, where U = Q s R'.

    Parameters
    ----------
    basis
        Q, (N, M).
    removed_share
        The share that whitening removes of a residual in each basis direction, (M,).
    """

    basis: np.ndarray
    removed_share: np.ndarray

    @classmethod
    def from_columns(cls, columns: np.ndarray) -> LowRankWhitening:
        """Decompose the columns U (N, M)."""
        basis, size, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(basis, 1.0 - 1.0 / np.sqrt(1.0 + size**2))

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Whiten the residuals of candidates (C, N)."""
        along = residual @ self.basis
        return np.asarray(residual - (self.removed_share * along) @ self.basis.T)


@dataclass(frozen=True)
class IndependentErrors:
    """An error model of one trial: independent noise, and displacements of known shape.

        V = scale^2 + U U'

    Parameters
    ----------
    scale
        The standard deviation of residuals over sigma.
    nuisance
        U over sigma, (2 n, M), or None: shapes whose amplitudes are N(0, 1), such as
        those of another initial state.
    """

    scale: float = 1.0
    nuisance: np.ndarray | None = None

    def whiten(self, residual: np.ndarray, grid_point: int = 0) -> np.ndarray:
        """Whiten residuals over sigma (C, 2 n)."""
        scaled = residual / self.scale
        return scaled if self._low_rank is None else self._low_rank(scaled)

    def with_nuisance(self, shapes: np.ndarray) -> IndependentErrors:
        """Add nuisance shapes (2 n, m) over sigma after the present ones."""
        present = [] if self.nuisance is None else [self.nuisance]
        return replace(self, nuisance=np.hstack([*present, shapes]))

    @cached_property
    def _low_rank(self) -> LowRankWhitening | None:
        if self.nuisance is None:
            return None
        return LowRankWhitening.from_columns(self.nuisance / self.scale)


UNIT_ERRORS = IndependentErrors()
