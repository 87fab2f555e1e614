"""What trials say of candidates: how far they are from what was measured, in standard deviations and white.

    residual_k = V_k^(-1/2) (simulated - measured) / sigma,        V_k = 1 + U_k U_k'

for trial k, whose points may also move by U_k a with unknown a ~ N(0, 1), such as by another state in the beginning.
Integrated over a, that is noise of covariance V_k: what U_k could explain counts for less, and what is found is sure
only of the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.stages.inference.batch import away
from stringcast.stages.inference.forward import Case
from stringcast.stages.inference.solver import LOST
from stringcast.stages.inference.whitening import LowRank
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter, values_of

BLOCK = 0.05  # [s] of time taken as one independent piece
STILL = 0.01  # of the string's length, from which the hand has moved, or a string has from where it ends


@dataclass(frozen=True)
class Likelihood:
    """Trials that one model explains together.

    scale: of each trial, times the points' own sigma, its noise and what the model lacks there; all are one where there
    are none. nuisance: U of each trial, over sigma, (2 n, M), or of none. limit: standard deviations from which a
    residual counts less (Huber), or infinite.
    """

    model: Model
    trials: tuple[Case, ...]
    scale: tuple[float, ...] = ()
    nuisance: tuple[np.ndarray, ...] = ()
    limit: float = np.inf

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Of the model."""
        return self.model.parameters

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Of candidates (C, P), (C, N): both coordinates of each point of each trial; LOST in a trial that could not be
        simulated."""
        return np.concatenate(self.by_trial(chi), axis=1)

    def by_trial(self, chi: np.ndarray) -> list[np.ndarray]:
        """The same, of each trial, (C, 2 n)."""
        found = away(self.model, self.trials, values_of(self.parameters, chi))
        found = [each / scale for each, scale in zip(found, self._scales, strict=True)]
        if self.nuisance:
            found = [whiten(each) for whiten, each in zip(self._whiten, found, strict=True)]
        return [np.nan_to_num(each, copy=False, nan=LOST) for each in found]

    def until(self, seconds: float) -> Likelihood:
        """The beginning of each trial: so long after its hand moved, or after it began moving."""
        trials = tuple(t.until(max(_begins(t) + seconds, t.times[:2][-1])) for t in self.trials)
        nuisance = tuple(u[: 2 * len(trial.s)] for u, trial in zip(self.nuisance, trials, strict=False))
        return replace(self, trials=trials, nuisance=nuisance)

    @cached_property
    def _whiten(self) -> list[LowRank]:
        return [LowRank.of(u / scale) for u, scale in zip(self.nuisance, self._scales, strict=True)]

    @property
    def _scales(self) -> tuple[float, ...]:
        return self.scale or (1.0,) * len(self.trials)


def time_blocks(trials: Sequence[Case]) -> np.ndarray:
    """Number of the block of time of each residual, (N,), counted through all trials."""
    pieces, first = [], 0
    for trial in trials:
        _, own = np.unique(np.floor(trial.times[trial.frame] / BLOCK).astype(int), return_inverse=True)
        pieces.append(np.repeat(first + own, 2))
        first += own.max() + 1
    return np.concatenate(pieces)


def _begins(trial: Case) -> float:
    """When a trial's string begins to move, with its hand or before [s]."""
    if trial.initial is not None:
        return float(trial.times[0])
    hand, length = trial.motion.actual(trial.model.arm, ()), trial.model.string.length
    away = np.abs((hand.pose[0] - hand.pose[0, 0]) * [1.0, 1.0, length]).max(axis=1)
    return hand.start + hand.tick * float(np.argmax(away > STILL * length))
