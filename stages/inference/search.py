"""The most likely parameters from nothing: many starts, and a horizon that widens.

A string that is swung forgets where it came from, so that a whole trial has many local
minima. Its beginning is fitted first, then more of it, while the better half of the
starts goes on; those that have come to the same go on as one. The mesh is refined on
the way: all there is is fitted with the string as given, what comes before with coarser
ones. What another initial state could explain counts for little from the beginning, so
that no start is lost by that. In the end initial states, noise and parameters are found
in turns, and outliers count less.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.common import Progress, mad_sigma
from stringcast.stages.inference.huber import HUBER_LIMIT
from stringcast.stages.inference.initial_modes import (
    INITIAL_SPAN_S,
    initial_mode_columns,
    refine_initial_state,
)
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import mesh_ladder
from stringcast.stages.inference.solver import MAX_ITERATIONS, fit_least_squares
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.model.parameter import parameter_values
from stringcast.stages.model.statics.chain import GRAVITY_M_S2

# sqrt(L/g), fitted first: a quarter of the time in which a limp string swings to and
# fro
FIRST_HORIZON = np.pi / 2.405
# numbers measured for each parameter, at least, in the first horizon: as of any
# regression
MIN_NUMBERS_PER_PARAMETER = 10
HORIZON_GROWTH = 1.75  # of the horizon, from one to the next
WHOLE_TRIAL_SHARE = 0.8  # of the longest trial: a horizon beyond that is all there is
MIN_FINALISTS = 8  # starts that go on to the end, if they have come to different places
# of what is left, root mean square: runs that differ by less have come to the same
# place
SAME_PLACE_TOLERANCE = 0.1
# of the log-likelihood: gains so small still add up, on the way along a valley to its
# end
REFINEMENT_MIN_GAIN = 0.005
# at most, in which initial states, noise and parameters are found; it mostly takes
# three
MAX_REFINEMENT_ROUNDS = 10
# of the trials' noise, in the geometric mean: a round that lowers it by less is the
# last
MIN_LOG_NOISE_GAIN = 0.01
MIN_SCALE = 1e-9  # of the noise: of exact data something is left, too


def screen_candidates(
    likelihood: Likelihood, chi: np.ndarray, count: int
) -> np.ndarray:
    """Those candidates (C, P) that are best at the first horizon, best first, (count,
    P).
    """
    ahead = horizons(likelihood)
    some = _mesh_of_each_horizon(likelihood, len(ahead))[0].cut_after_onset(ahead[0])
    misfit = np.mean(some.residuals(chi) ** 2, axis=1)
    return chi[np.argsort(misfit, kind="stable")[:count]]


def horizons(likelihood: Likelihood) -> list[float]:
    """Beginnings of trials that are fitted one after the other [s]; the last is all
    there is.
    """
    length = likelihood.model.string.length
    trials = likelihood.data.trials
    spans = [max(float(np.ptp(trial.times)), MIN_SCALE) for trial in trials]
    rate = sum(
        2 * len(trial.s) / span for trial, span in zip(trials, spans, strict=True)
    )
    found = [
        max(
            FIRST_HORIZON * np.sqrt(length / GRAVITY_M_S2),
            MIN_NUMBERS_PER_PARAMETER * len(likelihood.parameters) / rate,
        )
    ]
    while found[-1] * HORIZON_GROWTH < WHOLE_TRIAL_SHARE * max(spans):
        found.append(found[-1] * HORIZON_GROWTH)
    return [*found, np.inf]


def search_parameters(
    likelihood: Likelihood,
    starts: np.ndarray,
    most: int,
    progress: Progress = lambda share: None,
) -> np.ndarray:
    """The best parameters (P,) from these starts (K, P), the best first. most:
    iterations of each before the last horizon.
    """
    chi, ahead = starts, horizons(likelihood)
    few = max(most // max(len(ahead) - 1, 1), 1)
    for number, (horizon, mesh) in enumerate(
        zip(ahead, _mesh_of_each_horizon(likelihood, len(ahead)), strict=True)
    ):
        some = with_estimated_noise(mesh.cut_after_onset(horizon), chi[0])
        fits = fit_least_squares(
            some, chi, few if np.isfinite(horizon) else MAX_ITERATIONS
        )
        chi = fits.chi[_survivors(fits.residual, fits.loss)]
        progress((number + 1) / len(ahead))
    return chi[0]


def _mesh_of_each_horizon(likelihood: Likelihood, count: int) -> list[Likelihood]:
    """The likelihood with the mesh of each horizon, each half as fine as the next as
    far as the ladder goes.
    """
    ladder = mesh_ladder(likelihood)
    return [ladder[min(before, len(ladder) - 1)] for before in reversed(range(count))]


def _survivors(residual: np.ndarray, loss: np.ndarray) -> list[int]:
    """Runs that go on, best first: the better half of those that have come to different
    places. residual: (K, N). loss: (K,).
    """
    kept: list[int] = []
    for run in np.argsort(loss, kind="stable")[: max(len(loss) // 2, MIN_FINALISTS)]:
        apart = [np.mean((residual[run] - residual[other]) ** 2) for other in kept]
        if all(each > SAME_PLACE_TOLERANCE**2 * loss[run] for each in apart):
            kept.append(int(run))
    return kept


def refine_solution(
    likelihood: Likelihood, chi: np.ndarray
) -> tuple[Likelihood, np.ndarray]:
    """The likelihood with noise and initial states as they are at its maximum, and the
    parameters there, from near ones chi (P,).
    """
    likelihood = with_refined_initial_states(likelihood, chi, INITIAL_SPAN_S)
    for number in range(MAX_REFINEMENT_ROUNDS):
        there = fit_least_squares(
            likelihood, chi[None], enough=REFINEMENT_MIN_GAIN
        ).chi[0]
        anew = with_refined_initial_states(likelihood, there)
        gain = np.mean(np.log(likelihood.noise_scales)) - np.mean(
            np.log(anew.noise_scales)
        )
        if gain > 0 or number == 0:
            likelihood, chi = anew, there
        if gain < MIN_LOG_NOISE_GAIN:
            break
    return likelihood, chi


def with_refined_initial_states(
    likelihood: Likelihood, chi: np.ndarray, span: float = np.inf
) -> Likelihood:
    """With the initial states that suit parameters (P,), and outliers that count less.
    span: of each trial's beginning that the states are found from [s].
    """
    values = parameter_values(likelihood.parameters, chi)
    trials = [
        refine_initial_state(trial, values, span) for trial in likelihood.data.trials
    ]
    return replace(
        with_estimated_noise(likelihood.with_trials(trials), chi), limit=HUBER_LIMIT
    )


def with_estimated_noise(likelihood: Likelihood, chi: np.ndarray) -> Likelihood:
    """With what parameters (P,) leave in each trial taken for its noise, and what other
    initial states could explain counting for little.

    What a model lacks is more in some trials than in others, and these must not pay for
    it: with one scale for all of four trials, of which a hardening bends two, a search
    ended 2.5 to 20 noises off, and ends 1 to 9 off with these.
    """
    plain = likelihood.with_trials(
        [replace(t, error_model=UNIT_ERRORS) for t in likelihood.data.trials]
    )
    residuals = plain.residuals_by_trial(chi[None])
    columns = initial_mode_columns(
        plain.data.trials, parameter_values(likelihood.parameters, chi)
    ) or (None,) * len(residuals)
    trials = []
    for trial, residual, shapes in zip(
        plain.data.trials, residuals, columns, strict=True
    ):
        errors = IndependentErrors(float(mad_sigma(residual)) + MIN_SCALE, shapes)
        trials.append(replace(trial, error_model=errors))
    return plain.with_trials(trials)
