"""The base model: a string without causes, fitted from many starts."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.stats.qmc import Halton

from stringcast.stages.common import Progress, choose_evenly
from stringcast.stages.diagnose.evidence.measures import (
    mean_explained_fraction,
    refit,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.rules import (
    NEGLIGIBLE_LOG_EVIDENCE,
    STRONG_LOG_EVIDENCE,
    Criteria,
)
from stringcast.stages.inference import solver
from stringcast.stages.inference.discrepancy_grid import grid_points_of_later_onsets
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import (
    Fit,
    fit_hypothesis,
    hypothesis_likelihood,
    log_likelihoods,
)
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import with_model
from stringcast.stages.inference.search import (
    refine_solution,
    screen_candidates,
    search_parameters,
    with_estimated_noise,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.kept_results import keep_results
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter

log = logging.getLogger(__name__)

RANGE_END_FRACTION = 0.02  # of a range: a parameter nearer to its end is at the end
RANGE_WIDENING_FACTOR = 30.0
MAX_WIDENING_ROUNDS = 3
WIDENING_ITERATIONS = 8  # enough to see whether a wider range explains much more
MAX_SEARCH_ITERATIONS = 20  # before the last horizon
# In the last horizon and after it. A model that misfits converges slowly, and is fitted
# again with mesh error and discrepancy
MAX_LAST_ITERATIONS = 20
SCREENED_PER_START = 8
UNKNOWN_MOTION_M = 0.03  # assumed scale of a discrepancy that begins in a trial
SCREENED_STRINGS = 64  # for fits to the beginnings of trials
BEGINNING_ITERATIONS = 12  # of fits to the beginnings of trials
MAX_SEARCHED_TRIALS = 8  # in the search from many starts; its best fit starts from all


def fit_base_model(
    likelihood: Likelihood,
    rng: np.random.Generator,
    starts: int,
    progress: Progress,
) -> tuple[Likelihood, np.ndarray]:
    """Fit the base model from many starts, widening ranges where the data require it.

    Parameters
    ----------
    likelihood : Likelihood
        Trials and the base model.
    rng : numpy.random.Generator
        Generator of the starts.
    starts : int
        Number of starts after the screening.
    progress : callable
        Called with the share of the search that is done.

    Returns
    -------
    likelihood : Likelihood
        The likelihood with the final ranges and initial states.
    chi : numpy.ndarray, shape (P,)
        Exponents of the best fit.
    """
    configured = likelihood.model.exponents_of_values({})
    drawn = rng.uniform(size=(SCREENED_PER_START * starts, len(configured)))
    candidates = np.concatenate([configured[None], drawn])
    sample = sample_trials(likelihood)
    best = screen_candidates(sample, candidates, starts)
    chi = search_parameters(
        sample,
        best,
        MAX_SEARCH_ITERATIONS,
        progress,
        last_iterations=MAX_LAST_ITERATIONS,
    )
    for _ in range(MAX_WIDENING_ROUNDS):
        before = sample
        for index in range(len(chi)):
            sample, chi = widen_range_if_supported(sample, chi, index)
        if sample is before:
            break
    widened = likelihood.with_model(sample.model)
    return refine_solution(widened, chi, MAX_LAST_ITERATIONS)


def sample_trials(likelihood: Likelihood) -> Likelihood:
    """Select at most MAX_SEARCHED_TRIALS trials, evenly."""
    trials = likelihood.data.trials
    chosen = choose_evenly(len(trials), MAX_SEARCHED_TRIALS)
    return likelihood.with_trials([trials[k] for k in chosen])


def widen_range_if_supported(
    likelihood: Likelihood,
    chi: np.ndarray,
    index: int,
) -> tuple[Likelihood, np.ndarray]:
    """Widen the range of a string parameter at its end, if that explains much more.

    An undetermined parameter may be at an end, too, but gains nothing by a wider range.
    """
    parameter = likelihood.parameters[index]
    wider = _in_wider_range(likelihood.model, parameter, chi[index])
    if wider is None:
        return likelihood, chi
    start = wider.exponents_of_values(likelihood.model.values_at(chi))
    widened = with_estimated_noise(likelihood.with_model(wider), start)

    # The gain in log-likelihood at the best noise level, as in `solver`
    before = widened.residuals(start[None])[0]
    after = solver.fit_least_squares(
        widened, start[None], WIDENING_ITERATIONS, STRONG_LOG_EVIDENCE
    )
    gain = 0.5 * len(before) * np.log(np.mean(before**2) / after.loss[0])
    if gain > STRONG_LOG_EVIDENCE:
        return widened, after.chi[0]
    return likelihood, chi


def _in_wider_range(
    model: Model, parameter: Parameter, exponent: float
) -> Model | None:
    """Widen a string parameter's range if it lies at an end; None if it does not."""
    ranges = model.string.ranges
    at_end = not RANGE_END_FRACTION < exponent < 1 - RANGE_END_FRACTION
    is_free = parameter.name in ranges and parameter.low > 0
    if not at_end or not is_free or parameter.name in model.measured_ranges:
        return None
    low = parameter.low
    high = parameter.high
    if exponent < 0.5:
        low = low / RANGE_WIDENING_FACTOR
    else:
        high = high * RANGE_WIDENING_FACTOR
    return model.with_ranges(replace(ranges[parameter.name], low=low, high=high))


def fit_from_beginnings(data: TrialData, fit: Fit) -> Fit:
    """Refit a hypothesis, first to the beginnings of all trials.

    An unknown disturbance in the middle of trials biases fits to whole trials. So the
    trials are fitted as if a discrepancy began at each later onset in turn, from the
    given fit and from the other string that fits the beginnings best. The best of these
    fits is refined with the most likely grid points.
    """
    hypothesis = fit.hypothesis
    sequence = Halton(len(fit.chi), scramble=False)
    others = sequence.random(SCREENED_STRINGS + 1)[1:]  # the first is zero
    residuals = data.residuals(hypothesis.model, others)

    ends = []
    for grid_point in grid_points_of_later_onsets(UNKNOWN_MOTION_M):
        grid_points = np.full(len(data.trials), grid_point)
        likelihood = hypothesis_likelihood(data, hypothesis, grid_points)
        white = likelihood.data.whiten(residuals, grid_points)
        other = others[int(np.argmin(np.sum(white**2, axis=1)))]
        starts = np.stack([fit.chi, other])
        ends.append(_fit_beginnings(likelihood, starts))
    ends_of_all = np.concatenate(ends)
    by_end = log_likelihoods(data, hypothesis, ends_of_all).sum(axis=0)
    best = ends_of_all[int(np.argmax(by_end))]
    return fit_hypothesis(data, hypothesis, best[None], fit.grid_points)


@keep_results
def _fit_beginnings(likelihood: Likelihood, starts: np.ndarray) -> np.ndarray:
    """Fit trials whose discrepancy begins late from starts; return exponents (R, P)."""
    run = solver.fit_least_squares(
        likelihood,
        starts,
        BEGINNING_ITERATIONS,
        STRONG_LOG_EVIDENCE,
        solver.MAX_GAINS_BEHIND,
    )
    return np.asarray(run.chi)


def widen_ranges_with_causes(
    data: TrialData, fit: Fit, criteria: Criteria
) -> Model | None:
    """Widen the range of a string parameter that is at its end in a fit with causes.

    In too narrow a range, a false cause would compensate. The wider range must remove
    `min_explained_fraction` of the remaining misfit: evidence is no criterion, because
    it rises for little if the model is incomplete.

    Parameters
    ----------
    data : TrialData
        Trials corrected at the fit.
    fit : Fit
        The fit with the causes.

    Returns
    -------
    Model or None
        The base model in the wider range; None if the ranges are wide enough.
    """
    hypothesis = fit.hypothesis
    wider_models = {}
    for parameter, exponent in zip(hypothesis.parameters, fit.chi, strict=True):
        wider = _in_wider_range(hypothesis.base, parameter, exponent)
        if wider is not None:
            wider_models[parameter.name] = wider
    if not wider_models:
        return None

    # Compare without the mesh correction: its centre has exponents of the narrow range
    data = replace(data, mesh_correction=None)
    narrow = refit(data, fit, hypothesis, NEGLIGIBLE_LOG_EVIDENCE)
    left_m = unexplained_tip_rms(data, narrow)
    for name, wider in wider_models.items():
        widened = Hypothesis(wider, hypothesis.causes)
        start = widened.model.exponents_of_values(narrow.values)
        refitted = fit_hypothesis(
            data, widened, start[None], fit.grid_points, NEGLIGIBLE_LOG_EVIDENCE
        )
        explained = mean_explained_fraction(
            left_m, unexplained_tip_rms(data, refitted), criteria.tip_tolerance_m
        )
        if explained >= criteria.min_explained_fraction:
            log.info("the range of %s is too narrow", name)
            return wider
    return None


def search_other_strings(
    data: TrialData,
    fit: Fit,
    rng: np.random.Generator,
    starts: int,
) -> np.ndarray:
    """Search the best exponents (P,) from random strings and from those of a fit.

    The optimum of the base model may be a poor start for a model with a cause. The
    parameters of causes start from the fit.

    Parameters
    ----------
    data : TrialData
        Trials corrected at the fit.
    fit : Fit
        A fit with causes.
    rng : numpy.random.Generator
        Generator of the random strings.
    starts : int
        Number of starts after the screening, the fit among them.
    """
    hypothesis = fit.hypothesis
    is_cause = np.zeros(len(fit.chi), dtype=bool)
    for cause in hypothesis.causes:
        is_cause[hypothesis.parameter_indices(cause, cause.parameters)] = True
    drawn = rng.uniform(size=(SCREENED_PER_START * starts, len(fit.chi)))
    candidates = np.where(is_cause, fit.chi, drawn)
    trials = with_model(data.trials, hypothesis.model)
    sample = sample_trials(Likelihood(TrialData(trials), hypothesis.model))
    best = screen_candidates(sample, candidates, starts - 1)
    tried = np.concatenate([fit.chi[None], best])
    return search_parameters(
        sample,
        tried,
        MAX_SEARCH_ITERATIONS,
        last_iterations=MAX_LAST_ITERATIONS,
    )
