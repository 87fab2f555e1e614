"""Whitening of correlated noise: what makes residuals of one covariance independent, with deviations of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LowRank:
    """Of the covariance 1 + U U': V^(-1/2) r = r - Q (1 - (1 + s^2)^(-1/2)) Q' r, where U = Q s R'.

    basis: Q (N, M). taken: of each of its directions, (M,), the share of a residual that is taken away.
    """

    basis: np.ndarray
    taken: np.ndarray

    @classmethod
    def of(cls, columns: np.ndarray) -> LowRank:
        """With these columns U (N, M)."""
        basis, size, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(basis, 1.0 - 1.0 / np.sqrt(1.0 + size**2))

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """White residuals of candidates (C, N)."""
        along = np.einsum("cn,nm->cm", residual, self.basis)
        return residual - np.einsum("cm,nm->cn", self.taken * along, self.basis)
