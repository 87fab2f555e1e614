"""Compute the prediction error of an estimate in a held-out trial.

Two things are fitted to the trial itself: its initial state, refined as in a fit
(`initial_modes`), and the values of effects that differ between trials, such as a set,
from the frames in which the string rests.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation, TrialSet
from stringcast.data.estimates import PREDICTED, SCORE, Estimate, Prediction
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.inference.batch import normalised_residuals
from stringcast.stages.inference.initial_modes import (
    initial_state_parameters,
    refine_initial_state,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL, fit_least_squares
from stringcast.stages.model.engine.kernel_codegen import LANES
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_values,
)
from stringcast.stages.spec import StageCall

# shift of the tip below which the hand rests, as a share of the string's length;
# the noise of markers is 2 to 4 mm
REST_SHARE = 0.005


def run(call: StageCall, trials: TrialSet, estimate: Estimate) -> Prediction:
    """Predict one trial until its string touches an obstacle."""
    (trial,) = trials.observations
    observation = trim_at_contact(trial, call.setup.obstacles)
    own_effects = call.setup.effects_per_recording
    return predict(call.setup.model, estimate, observation, own_effects)


def predict(
    model: Model,
    estimate: Estimate,
    observation: Observation,
    own_effects: Collection[str],
) -> Prediction:
    """Predict the positions of the estimated string in a trial.

    Parameters
    ----------
    observation
        The trial; its initial state is fitted.
    own_effects
        Effects whose values are fitted to the trial if its string rests before the hand
        moves; otherwise the estimated values are used.
    """
    values = model.values(estimate.values())
    trial = refine_initial_state(prepare_trial(model, observation), values)
    free = 0
    if trial.initial_state is not None:
        free = len(initial_state_parameters(model.string))

    indices = [
        i for i, n in enumerate(model.names) if n.partition(".")[0] in own_effects
    ]
    rest = resting_part(trial)
    if indices and rest is not None:
        at_rest = _RestProblem(rest, values, indices)
        start = parameter_exponents(at_rest.parameters, values[indices])
        fit = fit_least_squares(at_rest, start[None])
        values = at_rest.full_values(fit.chi)[0]
        free += len(indices)

    _, motion = next(trial.simulate(values[None]))
    predicted = trial.sample_at_points(motion.points)[0]
    squares = np.sum((predicted - trial.points) ** 2, axis=-1)
    at_tip = trial.s == trial.s.max()
    score = {
        "trial": trial.name,
        "free": free,
        "rms": np.sqrt(squares.mean()),
        "tip": np.sqrt(squares[at_tip].mean()),
    }
    rows = {
        "trial": trial.name,
        "t": trial.times[trial.frame],
        "s": trial.s,
        "x": trial.points[:, 0],
        "y": trial.points[:, 1],
        "predicted_x": predicted[:, 0],
        "predicted_y": predicted[:, 1],
    }
    return Prediction(
        PREDICTED.check(pd.DataFrame(rows)), SCORE.check(pd.DataFrame([score]))
    )


def resting_part(trial: PreparedTrial) -> PreparedTrial | None:
    """Cut a trial to the frames in which its string rests before the hand moves.

    None if there are no such frames, or if the trial starts in motion.
    """
    if trial.initial_state is not None:
        return None
    hand = trial.motion.actual_hand_motion(trial.model.arm, ())
    length = trial.model.string.length
    shift = np.abs(hand.pose[0] - hand.pose[0, 0])
    tip_shift = np.hypot(shift[:, 0], shift[:, 1]) + length * shift[:, 2]
    moves = tip_shift > REST_SHARE * length
    last = hand.end
    if moves.any():
        last = hand.start + hand.tick * (np.argmax(moves) - 1)
    frames = int(np.searchsorted(trial.times, last, side="right"))
    return trial.first_frames(frames) if frames else None


@dataclass(frozen=True)
class _RestProblem:
    """Solver problem: fit some parameters to a string at rest.

    Parameters
    ----------
    trial
        Frames in which the string rests.
    values
        Values of all parameters, (P,).
    indices
        Indices of the fitted parameters.
    """

    trial: PreparedTrial
    values: np.ndarray
    indices: list[int]
    limit: float = np.inf

    @property
    def candidates_at_once(self) -> int:
        """Number of candidates that together take as long as one."""
        return LANES

    @property
    def parameters(self) -> list[Parameter]:
        """Parameters that are fitted to the trial."""
        return [self.trial.model.parameters[index] for index in self.indices]

    def full_values(self, chi: np.ndarray) -> np.ndarray:
        """Return the values of all parameters, (C, P), with the fitted ones at chi."""
        values = np.repeat(self.values[None], len(chi), axis=0)
        values[:, self.indices] = parameter_values(self.parameters, chi)
        return values

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute simulated minus measured points over sigma, (C, 2 N)."""
        values = self.full_values(chi)
        residuals = normalised_residuals(self.trial.model, [self.trial], values)
        return np.nan_to_num(residuals[0], nan=DIVERGED_RESIDUAL)
