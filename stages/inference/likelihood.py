"""How far candidates are from what was measured, in standard deviations and white: the
solver's least squares.

    residual_k = V_k^(-1/2) (simulated - measured) / sigma

for trial k, whose error model says V_k: independent noise of some scale, or a smooth
discrepancy of some size (`discrepancy`), and displacements U_k a with unknown a ~ N(0,
1), such as by another initial state. Integrated over a, that is noise of covariance
V_k: what U_k could explain counts for less, and what is found is sure only of the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter

BLOCK_S = 0.05  # [s] of time taken as one independent piece
# of the string's length, from which the hand has moved, or a string has from where it
# ends
MOTION_SHARE = 0.01
PRIOR_PRECISION = 12.0  # one over the variance of a chi that may lie anywhere in [0, 1]


@dataclass(frozen=True)
class Likelihood:
    """Trials that one model explains together.

    Parameters
    ----------
    data : the trials with their error models.
    model : the model that is fitted to them.
    sizes : of each trial, the number of its discrepancy's size, (K,); none where no trial has a discrepancy.
    limit : standard deviations beyond which a residual counts less (Huber), or infinite.
    uniform : indices of parameters that may lie anywhere in their range. Each has a normal prior of a uniform one's
        variance, which keeps those about the middle that the trials do not determine.
    """

    data: TrialData
    model: Model
    scale_indices: Sequence[int] | np.ndarray = ()
    limit: float = np.inf
    uniform_indices: Sequence[int] = ()

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def noise_scales(self) -> tuple[float, ...]:
        """The standard deviation of each trial's noise, in the points' own sigma, (K,)."""
        return tuple(trial.error_model.scale for trial in self.data.trials)

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute white residuals of candidates (C, P), those of the prior last, (C,
        N); LOST in a trial that diverged.
        """
        prior = np.sqrt(PRIOR_PRECISION) * (chi[:, list(self.uniform_indices)] - 0.5)
        return np.concatenate([*self.residuals_by_trial(chi), prior], axis=1)

    def residuals_by_trial(self, chi: np.ndarray) -> list[np.ndarray]:
        """Compute white residuals of each trial, (C, N_k)."""
        raw = self.data.residuals(self.model, chi)
        sizes = (
            np.asarray(self.scale_indices)
            if len(self.scale_indices)
            else np.zeros(len(raw), dtype=int)
        )
        white = self.data.whiten_by_trial(raw, sizes)
        return [
            np.where(
                (r == DIVERGED_RESIDUAL).any(axis=1, keepdims=True),
                DIVERGED_RESIDUAL,
                w,
            )
            for r, w in zip(raw, white, strict=True)
        ]

    def cut_after_onset(self, seconds: float) -> Likelihood:
        """Cut each trial this long after its hand moved, or after it began moving."""
        trials = [
            t.cut_after(max(_motion_onset(t) + seconds, t.times[:2][-1]))
            for t in self.data.trials
        ]
        return self.with_trials(trials)

    def with_trials(self, trials: Sequence[PreparedTrial]) -> Likelihood:
        """Replace the trials by the same ones made ready otherwise."""
        return replace(self, data=replace(self.data, trials=tuple(trials)))


def time_blocks(trials: Sequence[PreparedTrial]) -> np.ndarray:
    """Number of the block of time of each residual, (N,), counted through all trials."""
    pieces, first = [], 0
    for trial in trials:
        _, own = np.unique(
            np.floor(trial.times[trial.frame] / BLOCK_S).astype(int),
            return_inverse=True,
        )
        pieces.append(np.repeat(first + own, 2))
        first += own.max() + 1
    return np.concatenate(pieces)


def _motion_onset(trial: PreparedTrial) -> float:
    """When a trial's string begins to move, with its hand or before [s]."""
    if trial.initial_state is not None:
        return float(trial.times[0])
    hand, length = (
        trial.motion.actual_hand_motion(trial.model.arm, ()),
        trial.model.string.length,
    )
    away = np.abs((hand.pose[0] - hand.pose[0, 0]) * [1.0, 1.0, length]).max(axis=1)
    return hand.start + hand.tick * float(np.argmax(away > MOTION_SHARE * length))
