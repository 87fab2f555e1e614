"""The initial state of a trial, refined by the motion that follows.

A few frames give velocities to 0.1 m/s, which after half a swing is centimetres. Once
parameters are roughly known, the motion that follows gives more: shape and turning
rates are corrected by smooth modes of a string that is held at one end, as far as the
first part of the trial demands it. So is what hinges with a memory hold: the string's
earlier handling is unknown.
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

INITIAL_SPAN_S = 0.5  # [s] of the trial's beginning that the state is fitted to
SHAPE_MODE_SIGMA_RAD = 0.1  # [rad]: standard deviation of a mode of the shape
RATE_MODE_SIGMA_RAD_S = 3.0  # [rad/s]: standard deviation of a mode of the rates
DIFFERENCE_STEP = 1e-3  # of those, for the differences
MAX_AMPLITUDE = 20.0  # of those, that a mode may be off
LET_BACK_SIGMA = 0.5  # standard deviation of `State.let_back`, a share of all the way
MODE_PARAMETERS = tuple(
    Parameter(f"mode_{k}", "1", "", -MAX_AMPLITUDE, MAX_AMPLITUDE, 0.0)
    for k in range(2 * INITIAL_MODES)
)
LET_BACK_PARAMETER = Parameter("let_back", "1", "", 0.0, 1 / LET_BACK_SIGMA, 0.0)


def initial_state_parameters(string: String) -> tuple[Parameter, ...]:
    """List the corrections of an initial state, each N(0, 1) before the data speak."""
    has_memory = any(string.memory_count(slot) for slot in SLOTS)
    return (*MODE_PARAMETERS, LET_BACK_PARAMETER) if has_memory else MODE_PARAMETERS


def refine_initial_state(
    ready: PreparedTrial, values: np.ndarray, span: float = INITIAL_SPAN_S
) -> PreparedTrial:
    """Fit the initial state to a trial's first part, with parameters (P,) held.

    The trial stays as it is where it begins at rest or cannot be simulated.
    """
    if ready.initial_state is None:
        return ready
    early = ready.cut_after(ready.times[0] + span)
    amplitudes = initial_amplitudes(ready)[None]
    residual = _residuals_at_amplitudes(early, values, amplitudes)[0]
    noise = float(mad_sigma(residual)) + 1e-12
    if not np.isfinite(noise):
        return ready
    return fit_initial_state(
        ready, early, values, lambda residual: residual / noise, HUBER_LIMIT
    )


def fit_initial_state(
    ready: PreparedTrial,
    seen: PreparedTrial,
    values: np.ndarray,
    white: Callable[[np.ndarray], np.ndarray],
    limit: float = np.inf,
) -> PreparedTrial:
    """Fit the initial state of a trial by least squares.

    Parameters
    ----------
    seen
        The part of the trial that is fitted.
    values
        Of the model's parameters, (P,).
    white
        Whitens residuals over sigma (C, 2 N).
    limit
        Standard deviations from which a residual counts less.
    """
    parameters = initial_state_parameters(ready.model.string)
    problem = _InitialStateProblem(seen, values, parameters, white, limit)
    start = parameter_exponents(problem.parameters, initial_amplitudes(ready))
    best = fit_least_squares(problem, start[None]).chi[0]
    return with_initial_amplitudes(ready, parameter_values(problem.parameters, best))


@dataclass(frozen=True)
class _InitialStateProblem:
    """The amplitudes of one trial's initial state as the solver's problem."""

    trial: PreparedTrial
    values: np.ndarray
    parameters: Sequence[Parameter]
    whiten: Callable[[np.ndarray], np.ndarray]
    limit: float

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute white residuals and the amplitudes themselves, (C, 2 N + M)."""
        amplitudes = parameter_values(self.parameters, chi)
        raw = _residuals_at_amplitudes(self.trial, self.values, amplitudes)
        lost = np.isnan(raw).any(axis=1, keepdims=True)
        white = np.where(lost, DIVERGED_RESIDUAL, self.whiten(np.nan_to_num(raw)))
        return np.hstack([white, amplitudes])


def initial_mode_columns(
    trials: Sequence[PreparedTrial], values: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Compute how points move over sigma with each trial's modes, (2 N, M).

    A trial at rest has no columns. Where all are at rest there is nothing at all.
    """
    if all(trial.initial_state is None for trial in trials):
        return ()
    columns = []
    for trial in trials:
        sigma = np.repeat(trial.sigma, 2)
        columns.append(initial_mode_slopes(trial, values) / sigma[:, None])
    return tuple(columns)


def initial_mode_slopes(ready: PreparedTrial, values: np.ndarray) -> np.ndarray:
    """Difference the measured points by the amplitudes of the initial state.

    Returns a column for each amplitude, (2 N, M) [m]: none where the trial begins at
    rest, zeros for what cannot be simulated. values: (P,).
    """
    if ready.initial_state is None:
        return np.empty((2 * len(ready.points), 0))
    start = initial_amplitudes(ready)
    # from the end of its range inwards
    step = np.where(start > 0, -DIFFERENCE_STEP, DIFFERENCE_STEP)
    offsets = np.concatenate([np.zeros((1, len(start))), np.diag(step)])
    in_metres = replace(ready, sigma=np.ones(len(ready.points)))
    rows = _residuals_at_amplitudes(in_metres, values, start + offsets)
    moved = np.ascontiguousarray(rows[1:].T)
    columns = (moved - rows[0][:, None]) / step
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def reset_initial_state_linear(
    ready: PreparedTrial, modes: np.ndarray
) -> PreparedTrial:
    """Displace points as if the trial began in the state of its first frames.

    This is first order. The prior of the initial state is centred on that state.
    modes: over sigma, (2 N, M), and maybe other columns after them.
    """
    amplitudes = initial_amplitudes(ready)
    moved = modes[:, : len(amplitudes)] @ amplitudes
    displacement = ready.sigma[:, None] * moved.reshape(-1, 2)
    return replace(ready, points=ready.points + displacement)


def initial_amplitudes(ready: PreparedTrial) -> np.ndarray:
    """Collect the amplitudes of a trial's initial state, (M,); none if at rest."""
    if ready.initial_state is None:
        return np.zeros(0)
    held = len(initial_state_parameters(ready.model.string)) - 2 * INITIAL_MODES
    let_back = np.full(held, ready.initial_state.memory_reversal / LET_BACK_SIGMA)
    return np.concatenate([ready.mode_amplitudes, let_back])


def with_initial_amplitudes(ready: PreparedTrial, to: np.ndarray) -> PreparedTrial:
    """Set the amplitudes of a trial's initial state.

    Modes are sin((k - 1/2) pi s / L) of the angles and of the rates; hinges with a
    memory are let back.

    to: amplitudes (M,), or one for each candidate, (C, M).
    """
    state, length = ready.initial_state, ready.model.string.length
    assert state is not None
    amplitudes = to[..., : 2 * INITIAL_MODES]
    more = amplitudes - ready.mode_amplitudes
    wave = (np.arange(INITIAL_MODES)[:, None] + 0.5) * np.pi * state.s / length
    shapes = np.sin(wave)
    moved_state = replace(
        state,
        angle=state.angle + SHAPE_MODE_SIGMA_RAD * more[..., :INITIAL_MODES] @ shapes,
        rate=state.rate + RATE_MODE_SIGMA_RAD_S * more[..., INITIAL_MODES:] @ shapes,
        memory_reversal=LET_BACK_SIGMA * to[..., 2 * INITIAL_MODES :].sum(axis=-1),
    )
    return replace(ready, initial_state=moved_state, mode_amplitudes=amplitudes)


def _residuals_at_amplitudes(
    ready: PreparedTrial, values: np.ndarray, changes: np.ndarray
) -> np.ndarray:
    """Compute residuals over sigma (C, 2 N) with amplitudes (C, M)."""
    moved = with_initial_amplitudes(ready, changes)
    candidates = np.repeat(values[None], len(changes), axis=0)
    return normalised_residuals(moved.model, [moved], candidates)[0]


def trials_with_reestimated_start(
    data: TrialData, fit: Fit
) -> tuple[PreparedTrial, ...]:
    """Find the most likely initial states of trials, given a fit and discrepancies."""
    if all(trial.initial_state is None for trial in data.trials):
        return data.trials
    hypothesis = fit.hypothesis
    data = data.for_hypothesis(hypothesis)
    values = parameter_values(hypothesis.parameters, fit.chi[None])[0]
    residuals = data.residuals(hypothesis.model, fit.chi[None])
    sizes = best_scale_index(data.log_likelihood_by_scale(residuals)[:, 0])
    trials = []
    for trial, size in zip(data.trials, sizes, strict=True):
        extended = replace(trial, model=hypothesis.model)
        if trial.initial_state is not None:
            extended = _most_likely_initial_state(trial, extended, int(size), values)
        trials.append(extended)
    return tuple(trials)


def with_initial_states_at(data: TrialData, fit: Fit) -> TrialData:
    """Restart trials in the most likely initial states, with the modes about those."""
    if all(trial.initial_state is None for trial in data.trials):
        return data
    values = parameter_values(fit.hypothesis.parameters, fit.chi[None])[0]
    started = trials_with_reestimated_start(data, fit)
    columns = initial_mode_columns(started, values)
    trials = []
    for trial, start, shapes in zip(data.trials, started, columns, strict=True):
        discrepancy = trial.discrepancy
        plain = reset_initial_state_linear(trial, -discrepancy.nuisance_shapes)
        centred = replace(start, points=plain.points)
        restarted = reset_initial_state_linear(centred, shapes)
        count = len(initial_amplitudes(trial))
        updated = discrepancy.replace_leading_nuisance(shapes, count)
        trials.append(replace(restarted, error_model=updated))
    return replace(data, trials=tuple(trials))


def _most_likely_initial_state(
    trial: PreparedTrial, extended: PreparedTrial, size: int, values: np.ndarray
) -> PreparedTrial:
    """Find the most likely initial state with values (P,) and a discrepancy's size.

    extended: the trial with the model that the values are of.
    """
    amplitudes = initial_amplitudes(trial)
    count, discrepancy = len(amplitudes), trial.discrepancy
    # by which the points were displaced to first order
    displaced = discrepancy.nuisance_shapes[:, :count] @ amplitudes
    rest = discrepancy.replace_leading_nuisance(
        discrepancy.nuisance_shapes[:, :0], count
    )

    def whiten(residual: np.ndarray) -> np.ndarray:
        return rest.whiten(residual + displaced, size)

    return fit_initial_state(extended, extended, values, whiten)
