"""The state in which a trial begins, corrected by how the string then moves.

A few frames tell velocities to 0.1 m/s, which after half a swing is centimetres. Once
parameters are known about well enough, the motion that follows tells more: shape and
turning rates are corrected by smooth modes of a string that is held at one end, as far
as the first part of the trial asks for it. So is what hinges with a memory hold: nobody
knows how the string was handled before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import mad_sigma
from stringcast.stages.inference.batch import normalised_residuals
from stringcast.stages.inference.discrepancy import best_scale_index
from stringcast.stages.inference.huber import HUBER_LIMIT
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.prepared_trial import INITIAL_MODES, PreparedTrial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL, fit_least_squares
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS as SLOTS
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_values,
)
from stringcast.stages.model.string import String

INITIAL_SPAN_S = 0.5  # [s] of the trial's beginning that is looked at
SHAPE_MODE_SIGMA_RAD = 0.1  # [rad] by which a mode of the shape may well be off
RATE_MODE_SIGMA_RAD_S = 3.0  # [rad/s] by which a mode of the rates may
DIFFERENCE_STEP = 1e-3  # of those, for the differences
MAX_AMPLITUDE = 20.0  # of those, that a mode may be off
# by which hinges may well have been let back, as a share of all the way
# (`State.let_back`)
LET_BACK_SIGMA = 0.5
MODE_PARAMETERS = tuple(
    Parameter(f"mode_{k}", "1", "", -MAX_AMPLITUDE, MAX_AMPLITUDE, 0.0)
    for k in range(2 * INITIAL_MODES)
)
LET_BACK_PARAMETER = Parameter("let_back", "1", "", 0.0, 1 / LET_BACK_SIGMA, 0.0)


def initial_state_parameters(string: String) -> tuple[Parameter, ...]:
    """What the state in which a trial begins is corrected by, each expected within one."""
    return (
        *MODE_PARAMETERS,
        *((LET_BACK_PARAMETER,) if any(map(string.memory_count, SLOTS)) else ()),
    )


def refine_initial_state(
    ready: PreparedTrial, values: np.ndarray, span: float = INITIAL_SPAN_S
) -> PreparedTrial:
    """The case with the initial state that suits these parameters (P,) best; as it is
    where it begins at rest, or where the string cannot be simulated with them.
    """
    if ready.initial_state is None:
        return ready
    early = ready.cut_after(ready.times[0] + span)
    noise = (
        float(
            mad_sigma(
                _residuals_at_amplitudes(
                    early, values, initial_amplitudes(ready)[None]
                )[0]
            )
        )
        + 1e-12
    )
    return (
        fit_initial_state(
            ready, early, values, lambda residual: residual / noise, HUBER_LIMIT
        )
        if np.isfinite(noise)
        else ready
    )


def fit_initial_state(
    ready: PreparedTrial,
    seen: PreparedTrial,
    values: np.ndarray,
    white: Callable[[np.ndarray], np.ndarray],
    limit: float = np.inf,
) -> PreparedTrial:
    """The case with the initial state by which what is seen of it is likeliest. white:
    of residuals over sigma (C, 2 N). limit: standard deviations from which one counts
    less.
    """
    problem = _InitialStateProblem(
        seen, values, initial_state_parameters(ready.model.string), white, limit
    )
    found = fit_least_squares(
        problem,
        parameter_exponents(problem.parameters, initial_amplitudes(ready))[None],
    )
    return with_initial_amplitudes(
        ready, parameter_values(problem.parameters, found.chi[0])
    )


@dataclass(frozen=True)
class _InitialStateProblem:
    """Modes of one trial's initial state, each expected within one, as the solver's
    problem.
    """

    trial: PreparedTrial
    values: np.ndarray
    parameters: Sequence[Parameter]
    whiten: Callable[[np.ndarray], np.ndarray]
    limit: float

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Of changes (C, M) in exponents, and the changes themselves: (C, 2 N + M)."""
        changes = parameter_values(self.parameters, chi)
        found = _residuals_at_amplitudes(self.trial, self.values, changes)
        lost = np.isnan(found).any(axis=1, keepdims=True)
        return np.hstack(
            [
                np.where(lost, DIVERGED_RESIDUAL, self.whiten(np.nan_to_num(found))),
                changes,
            ]
        )


def initial_mode_columns(
    trials: Sequence[PreparedTrial], values: np.ndarray
) -> tuple[np.ndarray, ...]:
    """How each trial's points move over sigma with its modes, (2 N, M): no columns
    where it begins at rest; none at all where all do.
    """
    if all(trial.initial_state is None for trial in trials):
        return ()
    return tuple(
        initial_mode_slopes(trial, values) / np.repeat(trial.sigma, 2)[:, None]
        for trial in trials
    )


def initial_mode_slopes(ready: PreparedTrial, values: np.ndarray) -> np.ndarray:
    """How the measured points move with the modes of the state in which the trial
    begins, a column each, (2 N, M) [m]; none where it begins at rest, zeros for what
    cannot be simulated. values: (P,).
    """
    if ready.initial_state is None:
        return np.empty((2 * len(ready.points), 0))
    start = initial_amplitudes(ready)
    # from the end of its range inwards
    step = np.where(start > 0, -DIFFERENCE_STEP, DIFFERENCE_STEP)
    changes = start + np.concatenate([np.zeros((1, len(start))), np.diag(step)])
    here, *beside = _residuals_at_amplitudes(
        replace(ready, sigma=np.ones(len(ready.points))), values, changes
    )
    columns = (np.stack(beside, axis=1) - here[:, None]) / step
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def reset_initial_state_linear(
    ready: PreparedTrial, modes: np.ndarray
) -> PreparedTrial:
    """The case with its points displaced, to first order, as if it began in the state
    that its first frames tell, about which other states are as likely as they are near.
    modes: over sigma, (2 N, M), and maybe others after them.
    """
    own = initial_amplitudes(ready)
    moved = modes[:, : len(own)] @ own
    return replace(
        ready, points=ready.points + ready.sigma[:, None] * moved.reshape(-1, 2)
    )


def initial_amplitudes(ready: PreparedTrial) -> np.ndarray:
    """How far the state of a trial is from what its first frames tell, in modes, (M,);
    none of one that begins at rest.
    """
    if ready.initial_state is None:
        return np.zeros(0)
    held = len(initial_state_parameters(ready.model.string)) - 2 * INITIAL_MODES
    return np.concatenate(
        [
            ready.mode_amplitudes,
            np.full(held, ready.initial_state.memory_reversal / LET_BACK_SIGMA),
        ]
    )


def trials_with_reestimated_start(
    data: TrialData, fit: Fit
) -> tuple[PreparedTrial, ...]:
    """Find the initial states of trials that are most likely with a fit, given its
    discrepancies.
    """
    if all(trial.initial_state is None for trial in data.trials):
        return data.trials
    hypothesis, data = fit.hypothesis, data.for_hypothesis(fit.hypothesis)
    values = parameter_values(hypothesis.parameters, fit.chi[None])[0]
    sizes = best_scale_index(
        data.log_likelihood_by_scale(data.residuals(hypothesis.model, fit.chi[None]))[
            :, 0
        ]
    )
    trials = []
    for trial, size in zip(data.trials, sizes, strict=True):
        extended = replace(trial, model=hypothesis.model)
        trials.append(
            extended
            if trial.initial_state is None
            else _most_likely_initial_state(trial, extended, int(size), values)
        )
    return tuple(trials)


def with_initial_states_at(data: TrialData, fit: Fit) -> TrialData:
    """Restart trials in the initial states that are most likely with a fit, with the
    modes about those.
    """
    if all(trial.initial_state is None for trial in data.trials):
        return data
    begun = trials_with_reestimated_start(data, fit)
    columns = initial_mode_columns(
        begun, parameter_values(fit.hypothesis.parameters, fit.chi[None])[0]
    )
    trials = []
    for trial, start, own in zip(data.trials, begun, columns, strict=True):
        discrepancy = trial.discrepancy
        plain = reset_initial_state_linear(trial, -discrepancy.nuisance_shapes)
        restarted = reset_initial_state_linear(replace(start, points=plain.points), own)
        trials.append(
            replace(
                restarted,
                error_model=discrepancy.replace_leading_nuisance(
                    own, len(initial_amplitudes(trial))
                ),
            )
        )
    return replace(data, trials=tuple(trials))


def _most_likely_initial_state(
    trial: PreparedTrial, extended: PreparedTrial, size: int, values: np.ndarray
) -> PreparedTrial:
    """Find the initial state of a trial that is most likely with values (P,) and a
    discrepancy of this size.

    extended: the trial with the model that the values are of.
    """
    amplitudes = initial_amplitudes(trial)
    count, discrepancy = len(amplitudes), trial.discrepancy
    # by which its points were displaced
    displaced = discrepancy.nuisance_shapes[:, :count] @ amplitudes
    rest = discrepancy.replace_leading_nuisance(
        discrepancy.nuisance_shapes[:, :0], count
    )
    return fit_initial_state(
        extended,
        extended,
        values,
        lambda residual: rest.whiten(residual + displaced, size),
    )


def _residuals_at_amplitudes(
    ready: PreparedTrial, values: np.ndarray, changes: np.ndarray
) -> np.ndarray:
    """Simulated less measured over sigma, (C, 2 N), with each of the changes (C, M) of
    the state at the beginning.
    """
    moved = with_initial_amplitudes(ready, changes)
    return normalised_residuals(
        moved.model, [moved], np.repeat(values[None], len(changes), axis=0)
    )[0]


def with_initial_amplitudes(ready: PreparedTrial, to: np.ndarray) -> PreparedTrial:
    """The case with other modes in its state, sin((k - 1/2) pi s / L) of the angles and
    of the rates, and hinges let back so far if they hold anything. to: (M,), or one for
    each candidate, (C, M).
    """
    state, length = ready.initial_state, ready.model.string.length
    assert state is not None
    more, let_back = (
        to[..., : 2 * INITIAL_MODES] - ready.mode_amplitudes,
        LET_BACK_SIGMA * to[..., 2 * INITIAL_MODES :].sum(axis=-1),
    )
    shapes = np.sin(
        (np.arange(INITIAL_MODES)[:, None] + 0.5) * np.pi * state.s / length
    )
    turn, rate = (
        SHAPE_MODE_SIGMA_RAD * more[..., :INITIAL_MODES] @ shapes,
        RATE_MODE_SIGMA_RAD_S * more[..., INITIAL_MODES:] @ shapes,
    )
    begun = replace(
        state,
        angle=state.angle + turn,
        rate=state.rate + rate,
        memory_reversal=let_back,
    )
    return replace(
        ready, initial_state=begun, mode_amplitudes=to[..., : 2 * INITIAL_MODES]
    )
