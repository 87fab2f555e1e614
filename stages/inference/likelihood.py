"""The likelihood of candidates as a least-squares problem for the solver.

    residual_k = V_k^(-1/2) (simulated - measured) / sigma

The error model of trial k gives the covariance V_k. It has independent noise, or a
smooth discrepancy of fixed course and scale (`discrepancy`), and displacements U_k a,
such as those by another initial state. The amplitudes a ~ N(0, 1) are integrated out,
so that residuals in the span of U_k have less weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.inference.prepared_trial import PreparedTrial, with_model
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter

BLOCK_S = 0.05  # residuals in different blocks are taken as independent
# of the string's length: hands and strings that move less are at rest
MOTION_SHARE = 0.01
PRIOR_PRECISION = 12.0  # one over the variance of a chi that is uniform in [0, 1]


@dataclass(frozen=True)
class Likelihood:
    """Trials that one model explains together.

    Parameters
    ----------
    data
        The trials with their error models.
    model
        The model that is fitted to them.
    grid_points
        The course and scale of each trial's discrepancy, (K,), as indices of the grid.
        None if no trial has a discrepancy.
    limit
        Huber's limit in standard deviations, above which a residual has less weight, or
        infinite.
    uniform_indices
        Indices of parameters with a uniform prior. A normal of the same variance
        replaces it, which keeps undetermined parameters in the middle of their range.
    """

    data: TrialData
    model: Model
    grid_points: np.ndarray | None = None
    limit: float = np.inf
    uniform_indices: Sequence[int] = ()

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def noise_scales(self) -> tuple[float, ...]:
        """The standard deviation of each trial's noise, in its points' sigma, (K,)."""
        return tuple(trial.error_model.scale for trial in self.data.trials)

    @property
    def candidates_at_once(self) -> int:
        """Number of candidates that take as long together as one."""
        return self.data.candidates_at_once

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute white residuals of candidates (C, P), (C, N).

        Those of the prior come last. Those of a diverged trial are DIVERGED_RESIDUAL.
        """
        from_middle = chi[:, list(self.uniform_indices)] - 0.5
        prior = np.sqrt(PRIOR_PRECISION) * from_middle
        return np.concatenate([*self.residuals_by_trial(chi), prior], axis=1)

    def residuals_by_trial(self, chi: np.ndarray) -> ByTrial:
        """Compute white residuals of each trial, (C, N_k)."""
        residuals = self.data.residuals(self.model, chi)
        grid_points = self.grid_points
        if grid_points is None:
            grid_points = np.zeros(len(residuals), dtype=int)
        white = []
        whitened = self.data.whiten_by_trial(residuals, grid_points)
        for residual, white_residual in zip(residuals, whitened, strict=True):
            diverged = (residual == DIVERGED_RESIDUAL).any(axis=1, keepdims=True)
            white.append(np.where(diverged, DIVERGED_RESIDUAL, white_residual))
        return white

    def cut_after_onset(self, seconds: float) -> Likelihood:
        """Cut each trial at a time after its motion onset."""
        trials = []
        for trial in self.data.trials:
            second_frame = trial.times[:2][-1]
            last = max(_motion_onset(trial) + seconds, second_frame)
            trials.append(trial.cut_after(last))
        return self.with_trials(trials)

    def with_trials(self, trials: Sequence[PreparedTrial]) -> Likelihood:
        """Replace the trials, keeping the random effects."""
        return replace(self, data=replace(self.data, trials=tuple(trials)))

    def with_model(self, model: Model) -> Likelihood:
        """Replace the model, also in the trials."""
        trials = with_model(self.data.trials, model)
        return replace(self.with_trials(trials), model=model)


def time_blocks(trials: Sequence[PreparedTrial]) -> np.ndarray:
    """Find the index of each residual's block of time, (N,), unique over all trials."""
    blocks = []
    first = 0
    for trial in trials:
        block = np.floor(trial.point_times / BLOCK_S)
        _, number = np.unique(block, return_inverse=True)
        blocks.append(np.repeat(first + number, 2))
        first += number.max() + 1
    return np.concatenate(blocks)


def _motion_onset(trial: PreparedTrial) -> float:
    """Find when the string begins to move: with its hand, or at the first frame [s]."""
    if trial.initial_state is not None:
        return float(trial.times[0])
    hand = trial.motion.actual_hand_motion(trial.model.arm, ())
    length = trial.model.string.length
    pose = hand.pose[0]
    metres_per_unit = [1.0, 1.0, length]  # an angle moves the tip of the string
    moved_m = np.abs((pose - pose[0]) * metres_per_unit)
    onset = np.argmax(moved_m.max(axis=1) > MOTION_SHARE * length)
    return hand.start + hand.tick * float(onset)
