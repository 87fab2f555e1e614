"""Prediction error of a model in a trial that nothing was fitted to.

Two things are taken from the trial itself: the state in which it begins, corrected as in a fit (`initial_modes`), and
the values of effects that differ from one trial to another, such as a set, read from the frames in which the string
rests.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import PREDICTED, SCORE, Estimate, Observation, Prediction, TrialSet
from stringcast.stages.estimate.trim import trimmed_at_contact
from stringcast.stages.inference.batch import away
from stringcast.stages.inference.forward import Case, case
from stringcast.stages.inference.initial_modes import coefficients, settled
from stringcast.stages.inference.solver import LOST, fitted
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter, chi_of, values_of
from stringcast.stages.spec import Call

RESTING = 0.005  # of the string's length: a hand that takes the tip no further rests; a marker's noise, 2 to 4 mm


def run(call: Call, trials: TrialSet, estimate: Estimate) -> Prediction:
    """The stage: prediction of the one trial given, until its string touches an obstacle."""
    (observation,) = (trimmed_at_contact(trial, call.setup.obstacles) for trial in trials.observations)
    return predict(call.setup.model, estimate, observation, call.setup.own)


def predict(model: Model, estimate: Estimate, observation: Observation, own: Collection[str]) -> Prediction:
    """Positions of the estimated string in a trial, which begins as this trial does. own: effects whose values are
    those of the trial, where the string rests before the hand moves; else they are as estimated."""
    ready = settled(case(model, observation), model.values(estimate.values()))
    values = model.values(estimate.values())
    free = 0 if ready.initial is None else len(coefficients(model.string))
    places = np.array([i for i, name in enumerate(model.names) if name.partition(".")[0] in own], dtype=int)
    still = resting(ready)
    if len(places) and still is not None:
        at_rest = _AtRest(still, values, places)
        start = chi_of(at_rest.parameters, values[places])
        values, free = at_rest.values_at(fitted(at_rest, start[None]).chi)[0], free + len(places)
    _, motion = next(ready.simulate(values[None]))
    found = ready.at_measured(motion.points)[0]
    squares, tip = np.sum((found - ready.points) ** 2, axis=-1), ready.s == ready.s.max()
    score = {"trial": ready.name, "free": free, "rms": np.sqrt(squares.mean()), "tip": np.sqrt(squares[tip].mean())}
    rows = {"trial": ready.name, "t": ready.times[ready.frame], "s": ready.s}
    for name, where in (("", ready.points), ("predicted_", found)):
        rows |= {f"{name}x": where[:, 0], f"{name}y": where[:, 1]}
    return Prediction(PREDICTED.check(pd.DataFrame(rows)), SCORE.check(pd.DataFrame([score])))


def resting(ready: Case) -> Case | None:
    """The frames in which a string rests before the hand moves; None where there are none, or it begins moving."""
    if ready.initial is not None:
        return None
    hand, length = ready.motion.actual(ready.model.arm, ()), ready.model.string.length
    moved = np.abs(hand.pose[0] - hand.pose[0, 0])
    moves = np.hypot(moved[:, 0], moved[:, 1]) + length * moved[:, 2] > RESTING * length
    last = hand.start + hand.tick * (np.argmax(moves) - 1) if moves.any() else hand.end
    frames = int(np.searchsorted(ready.times, last, side="right"))
    return ready.first(frames) if frames else None


@dataclass(frozen=True)
class _AtRest:
    """Some values, at these places, of a string at rest, as the solver asks for them."""

    still: Case
    values: np.ndarray
    places: np.ndarray
    limit: float = np.inf

    @property
    def parameters(self) -> list[Parameter]:
        """The parameters that are read from rest."""
        return [self.still.model.parameters[place] for place in self.places]

    def values_at(self, chi: np.ndarray) -> np.ndarray:
        """All values (C, P) with these read ones."""
        values = np.repeat(self.values[None], len(chi), axis=0)
        values[:, self.places] = values_of(self.parameters, chi)
        return values

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Simulated less measured over sigma, (C, 2 N)."""
        return np.nan_to_num(away(self.still.model, [self.still], self.values_at(chi))[0], nan=LOST)
