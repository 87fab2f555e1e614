"""How sure fitted parameters are: the sandwich estimate over blocks of time.

Residuals of neighbouring points and frames are not independent, whatever whitening knew of that, and a model that
lacks something leaves what changes slowly. So gradients are summed over blocks of time, and only the sums are taken as
independent (White 1980; Cameron and Miller 2015): right for any correlation within a block. A covariance that trusts
the whitening, (J'J)^(-1), would be the narrower the worse the whitening is. Before the data speak, every exponent in
the range counts as equally likely: that keeps an interval about what no data touches, alone or in combination, as wide
as the range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from stringcast.stages.inference.huber import loss, weights
from stringcast.stages.inference.likelihood import Likelihood, time_blocks
from stringcast.stages.inference.solver import FIRST, slopes, suited

PRIOR = 12.0  # one over the variance of a chi that may lie anywhere in [0, 1]


@dataclass(frozen=True)
class Covariance:
    """matrix: of chi, (P, P). blocks: how many it rests on."""

    matrix: np.ndarray
    blocks: int

    @property
    def correlation(self) -> np.ndarray:
        """(P, P)."""
        deviation = np.sqrt(np.diag(self.matrix))
        return self.matrix / np.outer(deviation, deviation)

    @property
    def reach(self) -> np.ndarray:
        """Half widths of 95 % intervals, (P,), by Student's t for so many blocks."""
        free = max(self.blocks - len(self.matrix), 1)
        return np.asarray(stdtrit(free, 0.975) * np.sqrt(np.diag(self.matrix)))


def covariance(likelihood: Likelihood, chi: np.ndarray) -> Covariance:
    """Of parameters (P,) at the maximum of a likelihood whose noise is known."""
    residual = likelihood.residuals(chi[None])
    width = np.full((1, len(chi)), FIRST)
    for _ in range(2):  # the first differences say how wide the second should be
        slope = slopes(likelihood, chi[None], residual, width)
        width = suited(slope, loss(residual, likelihood.limit))
    weight = weights(residual[0], likelihood.limit)
    return sandwich(slope[0], residual[0], weight, time_blocks(likelihood.trials))


def sandwich(slope: np.ndarray, residual: np.ndarray, weight: np.ndarray, block: np.ndarray) -> Covariance:
    """Of parameters with these slopes (P, N) of the white residuals (N,), weighted (N,), in numbered blocks (N,)."""
    size, count = len(slope), int(block.max()) + 1
    prior = PRIOR * np.eye(size)
    bread = np.linalg.inv((slope * weight) @ slope.T + prior)
    sums = np.stack([np.bincount(block, weight * residual * row, count) for row in slope])
    few = count / max(count - size, 1)
    return Covariance(bread @ (few * sums @ sums.T + prior) @ bread, count)
