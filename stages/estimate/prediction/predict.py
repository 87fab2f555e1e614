"""Prediction error of a model in a trial that nothing was fitted to.

Two things are taken from the trial itself: the state in which it begins, corrected as
in a fit (`initial_modes`), and the values of effects that differ from one trial to
another, such as a set, read from the frames in which the string rests.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import (
    PREDICTED,
    SCORE,
    Estimate,
    Observation,
    Prediction,
    TrialSet,
)
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.inference.batch import normalised_residuals
from stringcast.stages.inference.initial_modes import (
    initial_state_parameters,
    refine_initial_state,
)
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL, fit_least_squares
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_values,
)
from stringcast.stages.spec import StageCall

# of the string's length: a hand that takes the tip no further rests; a marker's noise,
# 2 to 4 mm
REST_SHARE = 0.005


def run(call: StageCall, trials: TrialSet, estimate: Estimate) -> Prediction:
    """The stage: prediction of the one trial given, until its string touches an
    obstacle.
    """
    (observation,) = (
        trim_at_contact(trial, call.setup.obstacles) for trial in trials.observations
    )
    return predict(
        call.setup.model, estimate, observation, call.setup.effects_per_recording
    )


def predict(
    model: Model, estimate: Estimate, observation: Observation, own: Collection[str]
) -> Prediction:
    """Positions of the estimated string in a trial, which begins as this trial does.
    own: effects whose values are those of the trial, where the string rests before the
    hand moves; else they are as estimated.
    """
    ready = refine_initial_state(
        prepare_trial(model, observation), model.values(estimate.values())
    )
    values = model.values(estimate.values())
    free = (
        0
        if ready.initial_state is None
        else len(initial_state_parameters(model.string))
    )
    places = np.array(
        [i for i, name in enumerate(model.names) if name.partition(".")[0] in own],
        dtype=int,
    )
    still = resting_part(ready)
    if len(places) and still is not None:
        at_rest = _RestProblem(still, values, places)
        start = parameter_exponents(at_rest.parameters, values[places])
        values, free = (
            at_rest.full_values(fit_least_squares(at_rest, start[None]).chi)[0],
            free + len(places),
        )
    _, motion = next(ready.simulate(values[None]))
    found = ready.sample_at_points(motion.points)[0]
    squares, tip = (
        np.sum((found - ready.points) ** 2, axis=-1),
        ready.s == ready.s.max(),
    )
    score = {
        "trial": ready.name,
        "free": free,
        "rms": np.sqrt(squares.mean()),
        "tip": np.sqrt(squares[tip].mean()),
    }
    rows = {"trial": ready.name, "t": ready.times[ready.frame], "s": ready.s}
    for name, where in (("", ready.points), ("predicted_", found)):
        rows |= {f"{name}x": where[:, 0], f"{name}y": where[:, 1]}
    return Prediction(
        PREDICTED.check(pd.DataFrame(rows)), SCORE.check(pd.DataFrame([score]))
    )


def resting_part(ready: PreparedTrial) -> PreparedTrial | None:
    """The frames in which a string rests before the hand moves; None where there are
    none, or it begins moving.
    """
    if ready.initial_state is not None:
        return None
    hand, length = (
        ready.motion.actual_hand_motion(ready.model.arm, ()),
        ready.model.string.length,
    )
    moved = np.abs(hand.pose[0] - hand.pose[0, 0])
    moves = (
        np.hypot(moved[:, 0], moved[:, 1]) + length * moved[:, 2] > REST_SHARE * length
    )
    last = hand.start + hand.tick * (np.argmax(moves) - 1) if moves.any() else hand.end
    frames = int(np.searchsorted(ready.times, last, side="right"))
    return ready.first_frames(frames) if frames else None


@dataclass(frozen=True)
class _RestProblem:
    """Some values, at these places, of a string at rest, as the solver asks for them."""

    trial: PreparedTrial
    values: np.ndarray
    indices: np.ndarray
    limit: float = np.inf

    @property
    def parameters(self) -> list[Parameter]:
        """The parameters that are read from rest."""
        return [self.trial.model.parameters[place] for place in self.indices]

    def full_values(self, chi: np.ndarray) -> np.ndarray:
        """All values (C, P) with these read ones."""
        values = np.repeat(self.values[None], len(chi), axis=0)
        values[:, self.indices] = parameter_values(self.parameters, chi)
        return values

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Simulated less measured over sigma, (C, 2 N)."""
        return np.nan_to_num(
            normalised_residuals(self.trial.model, [self.trial], self.full_values(chi))[
                0
            ],
            nan=DIVERGED_RESIDUAL,
        )
