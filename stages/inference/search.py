"""The most likely parameters from many starts, over a growing horizon.

The motion of a swung string is sensitive to its parameters, so that the misfit of a
whole trial has many local minima. The first part of a trial is fitted first, then more
and more of it. After each horizon the better half of the starts goes on; starts that
have reached the same minimum are merged. Short horizons use coarse meshes, the whole
trial the given one. Errors that another initial state could explain have little weight,
so that they do not eliminate a start. Finally initial states, noise and parameters are
refined in turn, with a robust loss.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.common import GRAVITY_M_S2, Progress, mad_sigma
from stringcast.stages.inference.huber import HUBER_LIMIT
from stringcast.stages.inference.initial_modes import (
    INITIAL_SPAN_S,
    initial_mode_columns,
    refine_initial_state,
)
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import mesh_ladder
from stringcast.stages.inference.solver import (
    MAX_GAINS_BEHIND,
    MAX_ITERATIONS,
    distinct_solutions,
    fit_least_squares,
)
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.kept_results import keep_results
from stringcast.stages.model.parameter import parameter_values

# The first horizon in sqrt(L/g): a quarter of the period of a limp hanging string
FIRST_HORIZON = np.pi / 2.405
# coordinates measured per parameter in the first horizon, usual in regression
MIN_NUMBERS_PER_PARAMETER = 10
HORIZON_GROWTH = 1.75  # ratio of successive horizons
WHOLE_TRIAL_SHARE = 0.8  # of the longest trial: a longer horizon is the whole trial
MIN_FINALISTS = 8  # starts that go on, if they have reached different minima
# in log-likelihood: such gains still add up along a valley
REFINEMENT_MIN_GAIN = 0.005
MAX_REFINEMENT_ROUNDS = 10  # usually three are enough
# of the noise, geometric mean over trials: a smaller reduction ends the refinement
MIN_LOG_NOISE_GAIN = 0.01
MIN_SCALE = 1e-9  # of the noise: keeps it positive where data are exact
MIN_SPAN_S = 1e-9  # for trials with a single frame


def screen_candidates(
    likelihood: Likelihood,
    chi: np.ndarray,
    count: int,
) -> np.ndarray:
    """Choose the `count` best candidates (C, P) at the first horizon, best first."""
    horizons_s = horizons(likelihood)
    coarsest = _mesh_of_each_horizon(likelihood, len(horizons_s))[0]
    early = coarsest.cut_after_onset(horizons_s[0])
    misfit = _mean_square(early, chi)
    return chi[np.argsort(misfit, kind="stable")[:count]]


@keep_results
def _mean_square(likelihood: Likelihood, chi: np.ndarray) -> np.ndarray:
    """Compute the mean square of the residuals of candidates (C, P)."""
    return np.asarray(np.mean(likelihood.residuals(chi) ** 2, axis=1))


def horizons(likelihood: Likelihood) -> list[float]:
    """List the horizons [s], shortest first; the last is infinite."""
    longest = 0.0
    rate = 0.0  # of measured numbers in all trials [1/s]
    for trial in likelihood.data.trials:
        span = max(float(np.ptp(trial.times)), MIN_SPAN_S)
        rate += 2 * len(trial.s) / span
        longest = max(longest, span)
    length = likelihood.model.string.length
    swing = FIRST_HORIZON * np.sqrt(length / GRAVITY_M_S2)
    determined = MIN_NUMBERS_PER_PARAMETER * len(likelihood.parameters) / rate
    horizon = max(swing, determined)
    horizons_s = [horizon]
    while horizon * HORIZON_GROWTH < WHOLE_TRIAL_SHARE * longest:
        horizon *= HORIZON_GROWTH
        horizons_s.append(horizon)
    return [*horizons_s, np.inf]


def search_parameters(
    likelihood: Likelihood,
    starts: np.ndarray,
    max_iterations: int,
    progress: Progress = lambda share: None,
    known: np.ndarray | None = None,
    last_iterations: int = MAX_ITERATIONS,
) -> np.ndarray:
    """Search the best parameters (P,) from several starts.

    Parameters
    ----------
    starts
        Exponents (R, P), the best first.
    max_iterations
        Iterations of each start, summed over all horizons but the last.
    known
        Exponents (P,) from earlier trials: a further start, only for the whole trials,
        because short horizons would move it away.
    last_iterations
        Largest number of iterations in the last horizon.
    """
    chi = starts
    horizons_s = horizons(likelihood)
    count = len(horizons_s)
    meshes = _mesh_of_each_horizon(likelihood, count)
    iterations = max(max_iterations // max(count - 1, 1), 1)
    for number, horizon in enumerate(horizons_s[:-1]):
        early = meshes[number].cut_after_onset(horizon)
        chi = _fit_until_horizon(early, chi, iterations)
        progress((number + 1) / count)
    if known is not None:
        chi = np.concatenate([chi, known[None]])
    best = _fit_whole_trials(meshes[-1], chi, last_iterations)
    progress(1.0)
    return best


@keep_results
def _fit_until_horizon(
    likelihood: Likelihood, starts: np.ndarray, iterations: int
) -> np.ndarray:
    """Fit trials that are cut at a horizon; return the surviving exponents (R, P)."""
    with_noise = with_estimated_noise(likelihood, starts[0])
    runs = fit_least_squares(with_noise, starts, iterations)
    return runs.chi[_survivors(runs.residual, runs.loss)]


@keep_results
def _fit_whole_trials(
    likelihood: Likelihood, starts: np.ndarray, iterations: int
) -> np.ndarray:
    """Fit whole trials from starts (R, P); return the best exponents (P,)."""
    with_noise = with_estimated_noise(likelihood, starts[0])
    runs = fit_least_squares(
        with_noise, starts, iterations, max_gains_behind=MAX_GAINS_BEHIND
    )
    return np.asarray(runs.chi[np.argmin(runs.loss)])


def _mesh_of_each_horizon(likelihood: Likelihood, count: int) -> list[Likelihood]:
    """List the likelihood on the mesh of each horizon, the finest last."""
    ladder = mesh_ladder(likelihood)
    coarsest = len(ladder) - 1
    return [ladder[min(level, coarsest)] for level in reversed(range(count))]


def _survivors(residual: np.ndarray, loss: np.ndarray) -> list[int]:
    """Choose the better half of the runs, without those with the same solution.

    residual: (R, N). loss: (R,). Returns indices, best first.
    """
    count = max(len(loss) // 2, MIN_FINALISTS)
    better = np.argsort(loss, kind="stable")[:count]
    distinct = distinct_solutions(residual[better], loss[better])
    return [int(better[number]) for number in distinct]


def refine_solution(
    likelihood: Likelihood,
    chi: np.ndarray,
    max_iterations: int = MAX_ITERATIONS,
) -> tuple[Likelihood, np.ndarray]:
    """Refine parameters (P,), noise and initial states in turn.

    max_iterations: for the parameters, in each round.

    Returns the likelihood with the refined noise and initial states, and the exponents
    of its maximum.
    """
    likelihood = with_refined_initial_states(likelihood, chi, INITIAL_SPAN_S)
    for number in range(MAX_REFINEMENT_ROUNDS):
        best = refine_exponents(likelihood, chi, max_iterations)
        updated = with_refined_initial_states(likelihood, best)
        before = np.log(likelihood.noise_scales)
        after = np.log(updated.noise_scales)
        gain = np.mean(before) - np.mean(after)
        if gain > 0 or number == 0:
            likelihood = updated
            chi = best
        if gain < MIN_LOG_NOISE_GAIN:
            break
    return likelihood, chi


@keep_results
def refine_exponents(
    likelihood: Likelihood, chi: np.ndarray, max_iterations: int
) -> np.ndarray:
    """Refine exponents (P,) at given noise and initial states."""
    runs = fit_least_squares(likelihood, chi[None], max_iterations, REFINEMENT_MIN_GAIN)
    return np.asarray(runs.chi[0])


def with_refined_initial_states(
    likelihood: Likelihood,
    chi: np.ndarray,
    span: float = np.inf,
) -> Likelihood:
    """Refine initial states and noise at parameters (P,), and use a robust loss.

    span: time from the start of each trial to which its state is fitted [s].
    """
    values = parameter_values(likelihood.parameters, chi)
    trials = []
    for trial in likelihood.data.trials:
        trials.append(refine_initial_state(trial, values, span))
    refined = with_estimated_noise(likelihood.with_trials(trials), chi)
    return replace(refined, limit=HUBER_LIMIT)


def with_estimated_noise(likelihood: Likelihood, chi: np.ndarray) -> Likelihood:
    """Estimate each trial's noise scale from its residual at parameters (P,).

    Scales differ because a model misfits some trials more than others. The new error
    models give little weight to errors that another initial state could explain.
    """
    trials = [replace(t, error_model=UNIT_ERRORS) for t in likelihood.data.trials]
    plain = likelihood.with_trials(trials)
    values = parameter_values(likelihood.parameters, chi)
    modelled = []
    for k, residual in enumerate(plain.residuals_by_trial(chi[None])):
        scale = float(mad_sigma(residual)) + MIN_SCALE
        errors = IndependentErrors(scale, initial_mode_columns(trials[k], values))
        modelled.append(replace(trials[k], error_model=errors))
    return plain.with_trials(modelled)
