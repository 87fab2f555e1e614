"""Refinement of a trial's initial state by the later motion.

A few frames give velocities within 0.1 m/s, an error of centimetres after half a swing.
Once parameters are roughly known, the later motion determines the state better. Shape
and turning rates are corrected by smooth modes of a string held at one end. So is the
state of hinges with memory, because the earlier handling of the string is unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import mad_sigma
from stringcast.stages.inference.batch import normalised_residuals
from stringcast.stages.inference.discrepancy_grid import most_likely_grid_point
from stringcast.stages.inference.huber import HUBER_LIMIT
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.prepared_trial import INITIAL_MODES, PreparedTrial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL, fit_least_squares
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.kept_results import keep_results
from stringcast.stages.model.engine.kernel_codegen import LANES
from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS as SLOTS
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_exponents,
    parameter_values,
)
from stringcast.stages.model.string import String

# In log-likelihood: parameters would compensate an error of the state
STATE_MIN_GAIN = 0.005
# The same if the amplitudes of modes are integrated out, which absorb the error
MODES_MIN_GAIN = 1.0
INITIAL_SPAN_S = 0.5  # first part of the trial, to which the state is fitted
SHAPE_MODE_SIGMA_RAD = 0.1  # standard deviation of a mode of the shape
RATE_MODE_SIGMA_RAD_S = 3.0  # standard deviation of a mode of the turning rates
# In standard deviations:
DIFFERENCE_STEP = 1e-3
MAX_AMPLITUDE = 20.0  # of a mode
LET_BACK_SIGMA = 0.5  # standard deviation of `StringState.memory_reversal`
MODE_PARAMETERS = tuple(
    Parameter(f"mode_{k}", "1", "", -MAX_AMPLITUDE, MAX_AMPLITUDE, 0.0)
    for k in range(2 * INITIAL_MODES)
)
LET_BACK_PARAMETER = Parameter("let_back", "1", "", 0.0, 1 / LET_BACK_SIGMA, 0.0)


def initial_state_parameters(string: String) -> tuple[Parameter, ...]:
    """List the corrections of an initial state, each with prior N(0, 1)."""
    has_memory = any(string.memory_count(slot) for slot in SLOTS)
    return (*MODE_PARAMETERS, LET_BACK_PARAMETER) if has_memory else MODE_PARAMETERS


def refine_initial_state(
    trial: PreparedTrial,
    values: np.ndarray,
    span: float = INITIAL_SPAN_S,
) -> PreparedTrial:
    """Fit the initial state to a trial's first part, at fixed parameters (P,).

    A trial that starts at rest or whose simulation diverges is returned unchanged.
    """
    if trial.initial_state is None:
        return trial
    return with_initial_amplitudes(trial, _fit_beginning(trial, values, span))


@keep_results
def _fit_beginning(trial: PreparedTrial, values: np.ndarray, span: float) -> np.ndarray:
    """Fit the amplitudes of the initial state (M,) to a trial's first part."""
    early = trial.cut_after(trial.times[0] + span)
    amplitudes = initial_amplitudes(trial)
    residual = _residuals_at_amplitudes(early, values, amplitudes[None])[0]
    noise = float(mad_sigma(residual)) + 1e-12
    if not np.isfinite(noise):
        return amplitudes
    fitted = fit_initial_state(
        trial,
        early,
        values,
        lambda residual: residual / noise,
        STATE_MIN_GAIN,
        HUBER_LIMIT,
    )
    return initial_amplitudes(fitted)


def fit_initial_state(
    trial: PreparedTrial,
    fitted_part: PreparedTrial,
    values: np.ndarray,
    whiten: Callable[[np.ndarray], np.ndarray],
    min_gain: float,
    limit: float = np.inf,
) -> PreparedTrial:
    """Fit the initial state of a trial by least squares.

    Parameters
    ----------
    fitted_part
        The part of the trial that is fitted.
    values
        Values of the model's parameters, (P,).
    whiten
        Whitens residuals over sigma (C, 2 N).
    min_gain
        A step that gains less log-likelihood is slow.
    limit
        Huber's limit in standard deviations.
    """
    parameters = initial_state_parameters(trial.model.string)
    problem = _InitialStateProblem(fitted_part, values, parameters, whiten, limit)
    start = parameter_exponents(parameters, initial_amplitudes(trial))
    best = fit_least_squares(problem, start[None], min_gain=min_gain).chi[0]
    return with_initial_amplitudes(trial, parameter_values(parameters, best))


@dataclass(frozen=True)
class _InitialStateProblem:
    """The least-squares problem of one trial's initial state."""

    trial: PreparedTrial
    values: np.ndarray
    parameters: Sequence[Parameter]
    whiten: Callable[[np.ndarray], np.ndarray]
    limit: float

    @property
    def candidates_at_once(self) -> int:
        """Number of candidates that take as long together as one."""
        return LANES

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """Compute white residuals and the amplitudes themselves, (C, 2 N + M)."""
        amplitudes = parameter_values(self.parameters, chi)
        residuals = _residuals_at_amplitudes(self.trial, self.values, amplitudes)
        diverged = np.isnan(residuals).any(axis=1, keepdims=True)
        white = self.whiten(np.nan_to_num(residuals))
        white = np.where(diverged, DIVERGED_RESIDUAL, white)
        return np.hstack([white, amplitudes])


def initial_mode_columns(trial: PreparedTrial, values: np.ndarray) -> np.ndarray:
    """Compute derivatives of points over sigma by the amplitudes of the initial state.

    Returns a column for each amplitude, (2 N, M): none if the trial starts at rest,
    zeros if the simulation diverges. values: (P,).
    """
    if trial.initial_state is None:
        return np.empty((2 * len(trial.points), 0))
    start = initial_amplitudes(trial)
    # Step towards zero, away from the bounds
    step = np.where(start > 0, -DIFFERENCE_STEP, DIFFERENCE_STEP)
    offsets = np.concatenate([np.zeros((1, len(start))), np.diag(step)])
    residuals = _residuals_at_amplitudes(trial, values, start + offsets)
    moved = np.ascontiguousarray(residuals[1:].T)
    columns = (moved - residuals[0][:, None]) / step
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def reset_initial_state_linear(
    trial: PreparedTrial,
    nuisance: np.ndarray,
) -> PreparedTrial:
    """Displace points as if the trial began in the state of its first frames.

    This is a first-order correction. It centres the prior of the initial state on that
    state. nuisance: shapes over sigma, (2 N, m), first the M of the initial state.
    """
    amplitudes = initial_amplitudes(trial)
    moved = nuisance[:, : len(amplitudes)] @ amplitudes
    return replace(trial, points=trial.points + trial.displacements_m(moved))


def initial_amplitudes(trial: PreparedTrial) -> np.ndarray:
    """Collect the amplitudes of a trial's initial state, (M,); none if at rest."""
    if trial.initial_state is None:
        return np.zeros(0)
    parameters = initial_state_parameters(trial.model.string)
    let_back = trial.initial_state.memory_reversal / LET_BACK_SIGMA
    let_back_count = len(parameters) - 2 * INITIAL_MODES  # 1 with a memory, else 0
    return np.concatenate([trial.mode_amplitudes, np.full(let_back_count, let_back)])


def with_initial_amplitudes(
    trial: PreparedTrial,
    amplitudes: np.ndarray,
) -> PreparedTrial:
    """Set the amplitudes of a trial's initial state.

    Modes are sin((k - 1/2) pi s / L) in angles and in rates; the last amplitude of a
    string with memory scales `StringState.memory_reversal`.

    amplitudes: (M,), or those of each candidate, (C, M).
    """
    state = trial.initial_state
    assert state is not None
    modes = amplitudes[..., : 2 * INITIAL_MODES]
    let_back = amplitudes[..., 2 * INITIAL_MODES :]
    change = modes - trial.mode_amplitudes
    shape_change = SHAPE_MODE_SIGMA_RAD * change[..., :INITIAL_MODES]
    rate_change = RATE_MODE_SIGMA_RAD_S * change[..., INITIAL_MODES:]

    number = np.arange(INITIAL_MODES)[:, None] + 0.5
    waves = np.sin(number * np.pi * state.s / trial.model.string.length)
    moved_state = replace(
        state,
        angle=state.angle + shape_change @ waves,
        rate=state.rate + rate_change @ waves,
        memory_reversal=LET_BACK_SIGMA * let_back.sum(axis=-1),
    )
    return replace(trial, initial_state=moved_state, mode_amplitudes=modes)


def _residuals_at_amplitudes(
    trial: PreparedTrial,
    values: np.ndarray,
    amplitudes: np.ndarray,
) -> np.ndarray:
    """Compute residuals over sigma (C, 2 N) with amplitudes (C, M)."""
    moved = with_initial_amplitudes(trial, amplitudes)
    candidates = np.repeat(values[None], len(amplitudes), axis=0)
    return normalised_residuals(moved.model, [moved], candidates)[0]


def trials_with_reestimated_start(
    data: TrialData,
    fit: Fit,
) -> tuple[PreparedTrial, ...]:
    """Find the most likely initial states of trials, given a fit."""
    if all(trial.initial_state is None for trial in data.trials):
        return data.trials
    hypothesis = fit.hypothesis
    data = data.for_hypothesis(hypothesis)
    values = parameter_values(hypothesis.parameters, fit.chi[None])[0]
    residuals = data.residuals(hypothesis.model, fit.chi[None])
    by_grid_point = data.log_likelihood_by_grid_point(residuals)[:, 0]
    grid_points = most_likely_grid_point(by_grid_point).tolist()
    trials = []
    for trial, grid_point in zip(data.trials, grid_points, strict=True):
        extended = replace(trial, model=hypothesis.model)
        if trial.initial_state is not None:
            extended = _most_likely_initial_state(trial, extended, grid_point, values)
        trials.append(extended)
    return tuple(trials)


def with_initial_states_at(data: TrialData, fit: Fit) -> TrialData:
    """Restart trials in the most likely initial states and linearise modes there."""
    if all(trial.initial_state is None for trial in data.trials):
        return data
    values = parameter_values(fit.hypothesis.parameters, fit.chi[None])[0]
    restarted = trials_with_reestimated_start(data, fit)
    trials = []
    for trial, restarted_trial in zip(data.trials, restarted, strict=True):
        shapes = initial_mode_columns(restarted_trial, values)
        # Restore the measured points, then displace them by the new modes
        discrepancy = trial.discrepancy
        measured = reset_initial_state_linear(trial, -discrepancy.nuisance_shapes)
        moved = replace(restarted_trial, points=measured.points)
        centred = reset_initial_state_linear(moved, shapes)
        count = len(initial_amplitudes(trial))
        updated = discrepancy.replace_leading_nuisance(shapes, count)
        trials.append(replace(centred, error_model=updated))
    return replace(data, trials=tuple(trials))


def _most_likely_initial_state(
    trial: PreparedTrial,
    extended: PreparedTrial,
    grid_point: int,
    values: np.ndarray,
) -> PreparedTrial:
    """Find the most likely initial state with values (P,) of the extended model.

    The state is fitted, so that its modes are removed from the nuisance. The trial's
    own model, to which these modes belong, may differ from that of the extended trial.
    """
    amplitudes = initial_amplitudes(trial)
    count = len(amplitudes)
    shapes = trial.discrepancy.nuisance_shapes
    displaced = shapes[:, :count] @ amplitudes  # as `reset_initial_state_linear` did
    rest = trial.discrepancy.replace_leading_nuisance(shapes[:, :0], count)

    def whiten(residual: np.ndarray) -> np.ndarray:
        return rest.whiten(residual + displaced, grid_point)

    return fit_initial_state(extended, extended, values, whiten, MODES_MIN_GAIN)
