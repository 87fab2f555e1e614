"""Measures by which fits are compared: displacements at the tip and evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.common import choose_evenly
from stringcast.stages.diagnose.evidence.predictions import (
    log_likelihood_gains,
    predict_left_out_trials,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, fit_hypothesis, mean_discrepancy
from stringcast.stages.inference.solver import MIN_GAIN, distinct_solutions
from stringcast.stages.inference.trial_data import (
    ByTrial,
    TrialData,
    subtract_by_trial,
)
from stringcast.stages.model.effect import Effect, is_position_dependent
from stringcast.stages.workers import map_in_workers


def refit(
    data: TrialData,
    fit: Fit,
    hypothesis: Hypothesis,
    min_gain: float = MIN_GAIN,
) -> Fit:
    """Fit a hypothesis from the parameters of any fit.

    Parameters
    ----------
    data : TrialData
        Trials, K of them.
    fit : Fit
        A fit to the same trials. Causes that it does not have start absent.
    hypothesis : Hypothesis
        The hypothesis to fit.
    min_gain : float
        A step that gains less log-likelihood is slow (`solver`).
    """
    start = hypothesis.exponents_from(fit.exponents)
    width = hypothesis.widths_from(fit.widths)
    return fit_hypothesis(
        data, hypothesis, start[None], fit.grid_points, min_gain, width
    )


def fit_in_workers(
    fit_one: Callable[[int], Fit], hypotheses: Sequence[Hypothesis]
) -> list[Fit]:
    """Fit hypotheses in parallel.

    fit_one: fits the hypothesis with a given index. Workers return copies of
    hypotheses, which are replaced by the originals.
    """
    fitted = map_in_workers(fit_one, range(len(hypotheses)))
    pairs = zip(fitted, hypotheses, strict=True)
    return [replace(fit, hypothesis=hypothesis) for fit, hypothesis in pairs]


def distinct_fits(fits: Sequence[Fit]) -> list[Fit]:
    """Select the best of the fits with the same solution, the best of all first.

    fits: to the same data.
    """
    residuals = np.stack([np.concatenate(fit.residuals) for fit in fits])
    distinct = distinct_solutions(residuals, np.mean(residuals**2, axis=1))
    return [fits[number] for number in distinct]


def residuals_without_nuisance(data: TrialData, fit: Fit) -> ByTrial:
    """Subtract the most likely nuisance from a fit's residuals, (2 n,)."""
    extended = data.for_hypothesis(fit.hypothesis)
    return extended.without_nuisance(fit.residuals, fit.grid_points)


def unexplained_tip_rms(data: TrialData, fit: Fit) -> np.ndarray:
    """Compute the root mean square discrepancy at the tip of each trial [m], (K,)."""
    return data.tip_rms_by_trial(mean_discrepancy(data, fit))


def sample_by_misfit(data: TrialData, fit: Fit, count: int) -> list[int]:
    """Choose up to `count` trials, spaced evenly in the order of their misfit.

    Returns their indices, sorted.
    """
    ranked = np.argsort(-unexplained_tip_rms(data, fit), kind="stable")
    return sorted(ranked[choose_evenly(len(ranked), count)].tolist())


def tip_shift_rms(data: TrialData, one: Fit, other: Fit) -> np.ndarray:
    """Compute the tip shift between two fits in each trial [m], (K,).

    It is the root mean square, over frames, of the distance between both tips.
    """
    return data.tip_rms_by_trial(subtract_by_trial(one.residuals, other.residuals))


def mean_explained_fraction(
    before: np.ndarray,
    after: np.ndarray,
    tolerance_m: float,
) -> float:
    """Average the explained fraction over trials that misfit by more than a tolerance.

    All trials have the same weight, however large their misfit.

    Parameters
    ----------
    before, after : numpy.ndarray, shape (K,)
        Unexplained tip displacement of each trial by two fits [m].
    tolerance_m : float
        Trials in which neither fit exceeds it are left out. If none exceeds it, only
        the trial with the largest misfit is used.
    """
    misfit = np.maximum(before, after)
    counted = misfit >= min(tolerance_m, misfit.max())
    return float(explained_fractions(before, after)[counted].mean())


def explained_fractions(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Compute the fraction of the mean square misfit that a second fit removes, (K,).

    It is relative to the larger of both: 1 if nothing is left, -1 if there was nothing.

    before, after: root mean squares of both fits, (K,) [m].
    """
    before = before**2
    after = after**2
    larger = np.maximum(np.maximum(before, after), np.finfo(float).tiny)
    return np.asarray((before - after) / larger)


def fixed_leave_one_out_gain(parent: Fit, fit: Fit) -> float:
    """Gain of log evidence without the most supportive trial, both fits unchanged."""
    by_trial = fit.log_likelihood_by_trial - parent.log_likelihood_by_trial
    return float(fit.log_evidence - parent.log_evidence - by_trial.max())


def refitted_leave_one_out_gain(data: TrialData, parent: Fit, fit: Fit) -> float:
    """Gain of log evidence without the most supportive trial, both fits refitted.

    That trial may have biased the fit.
    """
    gains = fit.log_likelihood_by_trial - parent.log_likelihood_by_trial
    strongest = int(np.argmax(gains))
    others = [k for k in range(len(data.trials)) if k != strongest]
    if not others:
        return -np.inf
    rest = data.subset(others)
    log_evidence = []
    for one in (fit, parent):
        grid_points = one.grid_points[others]
        refitted = fit_hypothesis(
            rest, one.hypothesis, one.chi[None], grid_points, width=one.width
        )
        log_evidence.append(refitted.log_evidence)
    return log_evidence[0] - log_evidence[1]


def cross_validated_gain(data: TrialData, parent: Fit, fit: Fit) -> float:
    """Gain of the predictive log-likelihood, without the trial that gains most.

    Each trial is predicted by the fit to the others. A parent may explain one trial at
    the cost of another; then only the latter seems to support a cause that explains
    both.
    """
    without = predict_left_out_trials(data, parent)
    gains = log_likelihood_gains(without, predict_left_out_trials(data, fit))
    return float(gains.sum() - gains.max())


def trials_touched_by(
    data: TrialData,
    fit: Fit,
    cause: type[Effect],
    min_tip_shift_m: float,
) -> np.ndarray:
    """Find the trials in which a cause that depends on place moves the tip enough.

    Parameters
    ----------
    data : TrialData
        Trials, K of them.
    fit : Fit
        A fit with the cause.
    cause : type of Effect
        A cause of the fit. None is found if it does not depend on place.
    min_tip_shift_m : float
        Root mean square displacement of a tip that is exceeded [m].

    Returns
    -------
    numpy.ndarray of int
        Indices of the trials.
    """
    if not is_position_dependent(cause):
        return np.zeros(0, dtype=int)
    hypothesis = fit.hypothesis
    amplitudes = hypothesis.amplitude_indices(cause)
    chi = fit.chi.copy()
    chi[amplitudes] = hypothesis.exponents_from({})[amplitudes]
    absent = data.residuals(hypothesis.model, chi[None])
    shift_m = data.tip_rms_by_trial(subtract_by_trial(fit.residuals, absent))  # (K, 1)
    return np.flatnonzero(shift_m > min_tip_shift_m)
