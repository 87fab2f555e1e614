"""The state in which a trial begins, corrected by how the string then moves.

A few frames tell velocities to 0.1 m/s, which after half a swing is centimetres. Once parameters are
known about well enough, the motion that follows tells more: shape and turning rates are corrected
by smooth modes of a string that is held at one end, as far as the first part of the trial asks for it. So is what
hinges with a memory hold: nobody knows how the string was handled before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import mad_sigma
from stringcast.stages.inference.batch import away
from stringcast.stages.inference.discrepancy import likeliest
from stringcast.stages.inference.evidence import Fit
from stringcast.stages.inference.forward import MODES, Case
from stringcast.stages.inference.huber import LIMIT
from stringcast.stages.inference.solver import LOST, fitted
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.parameter import Parameter, chi_of, values_of
from stringcast.stages.model.slots import HELD as SLOTS
from stringcast.stages.model.string import String

SPAN = 0.5  # [s] of the trial's beginning that is looked at
TURN = 0.1  # [rad] by which a mode of the shape may well be off
RATE = 3.0  # [rad/s] by which a mode of the rates may
STEP = 1e-3  # of those, for the differences
FARTHEST = 20.0  # of those, that a mode may be off
LET_BACK = 0.5  # by which hinges may well have been let back, as a share of all the way (`State.let_back`)
COEFFICIENTS = tuple(Parameter(f"mode_{k}", "1", "", -FARTHEST, FARTHEST, 0.0) for k in range(2 * MODES))
HELD = Parameter("let_back", "1", "", 0.0, 1 / LET_BACK, 0.0)


def coefficients(string: String) -> tuple[Parameter, ...]:
    """What the state in which a trial begins is corrected by, each expected within one."""
    return (*COEFFICIENTS, *((HELD,) if any(map(string.holds, SLOTS)) else ()))


def settled(ready: Case, values: np.ndarray, span: float = SPAN) -> Case:
    """The case with the initial state that suits these parameters (P,) best; as it is where it begins at rest, or where
    the string cannot be simulated with them."""
    if ready.initial is None:
        return ready
    early = ready.until(ready.times[0] + span)
    noise = float(mad_sigma(_residuals(early, values, change(ready)[None])[0])) + 1e-12
    return suited(ready, early, values, lambda residual: residual / noise, LIMIT) if np.isfinite(noise) else ready


def suited(
    ready: Case, seen: Case, values: np.ndarray, white: Callable[[np.ndarray], np.ndarray], limit: float = np.inf
) -> Case:
    """The case with the initial state by which what is seen of it is likeliest. white: of residuals over sigma (C,
    2 N). limit: standard deviations from which one counts less."""
    problem = _Beginning(seen, values, coefficients(ready.model.string), white, limit)
    found = fitted(problem, chi_of(problem.parameters, change(ready))[None])
    return with_change(ready, values_of(problem.parameters, found.chi[0]))


@dataclass(frozen=True)
class _Beginning:
    """Modes of one trial's initial state, each expected within one, as the solver's problem."""

    seen: Case
    values: np.ndarray
    parameters: Sequence[Parameter]
    white: Callable[[np.ndarray], np.ndarray]
    limit: float

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Of changes (C, M) in exponents, and the changes themselves: (C, 2 N + M)."""
        changes = values_of(self.parameters, chi)
        found = _residuals(self.seen, self.values, changes)
        lost = np.isnan(found).any(axis=1, keepdims=True)
        return np.hstack([np.where(lost, LOST, self.white(np.nan_to_num(found))), changes])


def modes(trials: Sequence[Case], values: np.ndarray) -> tuple[np.ndarray, ...]:
    """How each trial's points move over sigma with its modes, (2 N, M): no columns where it begins at rest; none at all
    where all do."""
    if all(trial.initial is None for trial in trials):
        return ()
    return tuple(slopes(trial, values) / np.repeat(trial.sigma, 2)[:, None] for trial in trials)


def slopes(ready: Case, values: np.ndarray) -> np.ndarray:
    """How the measured points move with the modes of the state in which the trial begins, a column each, (2 N, M) [m];
    none where it begins at rest, zeros for what cannot be simulated. values: (P,)."""
    if ready.initial is None:
        return np.empty((2 * len(ready.points), 0))
    start = change(ready)
    step = np.where(start > 0, -STEP, STEP)  # from the end of its range inwards
    changes = start + np.concatenate([np.zeros((1, len(start))), np.diag(step)])
    here, *beside = _residuals(replace(ready, sigma=np.ones(len(ready.points))), values, changes)
    columns = (np.stack(beside, axis=1) - here[:, None]) / step
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def as_first_told(ready: Case, modes: np.ndarray) -> Case:
    """The case with its points displaced, to first order, as if it began in the state that its first frames tell, about
    which other states are as likely as they are near. modes: over sigma, (2 N, M), and maybe others after them."""
    own = change(ready)
    moved = modes[:, : len(own)] @ own
    return replace(ready, points=ready.points + ready.sigma[:, None] * moved.reshape(-1, 2))


def change(ready: Case) -> np.ndarray:
    """How far the state of a trial is from what its first frames tell, in modes, (M,); none of one that begins at
    rest."""
    if ready.initial is None:
        return np.zeros(0)
    held = len(coefficients(ready.model.string)) - 2 * MODES
    return np.concatenate([ready.change, np.full(held, ready.initial.let_back / LET_BACK)])


def begun_anew(data: Data, fit: Fit) -> tuple[Case, ...]:
    """Find the initial states of trials that are most likely with a fit, given its discrepancies."""
    if all(trial.initial is None for trial in data.trials):
        return data.trials
    hypothesis, data = fit.hypothesis, data.of(fit.hypothesis)
    values = values_of(hypothesis.parameters, fit.chi[None])[0]
    sizes = likeliest(data.log_likelihoods(data.residuals(hypothesis.model, fit.chi[None]))[:, 0])
    trials = []
    for trial, size in zip(data.trials, sizes, strict=True):
        extended = replace(trial, model=hypothesis.model)
        trials.append(extended if trial.initial is None else _likeliest_beginning(trial, extended, int(size), values))
    return tuple(trials)


def about(data: Data, fit: Fit) -> Data:
    """Restart trials in the initial states that are most likely with a fit, with the modes about those."""
    if all(trial.initial is None for trial in data.trials):
        return data
    begun = begun_anew(data, fit)
    columns = modes(begun, values_of(fit.hypothesis.parameters, fit.chi[None])[0])
    trials = []
    for trial, start, own in zip(data.trials, begun, columns, strict=True):
        discrepancy = trial.discrepancy
        plain = as_first_told(trial, -discrepancy.modes)
        restarted = as_first_told(replace(start, points=plain.points), own)
        trials.append(replace(restarted, error_model=discrepancy.instead(own, len(change(trial)))))
    return replace(data, trials=tuple(trials))


def _likeliest_beginning(trial: Case, extended: Case, size: int, values: np.ndarray) -> Case:
    """Find the initial state of a trial that is most likely with values (P,) and a discrepancy of this size.

    extended: the trial with the model that the values are of.
    """
    amplitudes = change(trial)
    count, discrepancy = len(amplitudes), trial.discrepancy
    displaced = discrepancy.modes[:, :count] @ amplitudes  # by which its points were displaced
    rest = discrepancy.instead(discrepancy.modes[:, :0], count)
    return suited(extended, extended, values, lambda residual: rest.whiten(residual + displaced, size))


def _residuals(ready: Case, values: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Simulated less measured over sigma, (C, 2 N), with each of the changes (C, M) of the state at the beginning."""
    moved = with_change(ready, changes)
    return away(moved.model, [moved], np.repeat(values[None], len(changes), axis=0))[0]


def with_change(ready: Case, to: np.ndarray) -> Case:
    """The case with other modes in its state, sin((k - 1/2) pi s / L) of the angles and of the rates, and hinges let
    back so far if they hold anything. to: (M,), or one for each candidate, (C, M)."""
    state, length = ready.initial, ready.model.string.length
    assert state is not None
    more, let_back = to[..., : 2 * MODES] - ready.change, LET_BACK * to[..., 2 * MODES :].sum(axis=-1)
    shapes = np.sin((np.arange(MODES)[:, None] + 0.5) * np.pi * state.s / length)
    turn, rate = TURN * more[..., :MODES] @ shapes, RATE * more[..., MODES:] @ shapes
    begun = replace(state, angle=state.angle + turn, rate=state.rate + rate, let_back=let_back)
    return replace(ready, initial=begun, change=to[..., : 2 * MODES])
