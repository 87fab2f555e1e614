"""Evidence of rivals on the same data, each with the numerical error at its optimum.

A search subtracts the numerical error at the optimum of one fit from the measured
points. At the optimum of a rival this error is different. That changes log evidences by
up to hundreds, more than the differences between rivals. So each rival is fitted with
the error at its own optimum, until it does not move any more. Initial states, noise and
discrepancy are common to all.

A rival may be in a worse local minimum of the shared parameters. So it is also fitted
from those of the most evident other rival, and from other places and times where causes
may act. The more evident of both fits goes on. The gain that its last pass predicted
but did not reach is an error of the log evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.diagnose.evidence.measures import fit_in_workers
from stringcast.stages.diagnose.rules import NEGLIGIBLE_LOG_EVIDENCE
from stringcast.stages.diagnose.search.proposals import alternative_parameter_starts
from stringcast.stages.diagnose.trials.discrepancy_model import with_random_effects
from stringcast.stages.diagnose.trials.discretisation import (
    correct_data_on_one_finer_mesh,
    fit_mesh_correction,
)
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.inference.laplace import (
    Fit,
    best_exponents,
    evaluate_fit,
    log_likelihoods,
)
from stringcast.stages.inference.trial_data import TrialData

MAX_PASSES = 4  # of a fit and its numerical error; usually two are enough


def fit_to_common_data(
    prepared: PreparedData,
    rivals: Sequence[Fit],
    fitted_before: Sequence[Fit] = (),
    min_gain: float = NEGLIGIBLE_LOG_EVIDENCE,
) -> list[Fit]:
    """Fit each rival to the measured points with its own numerical error.

    Parameters
    ----------
    prepared : PreparedData
        The data of the search, with their initial states and error models.
    rivals : sequence of Fit
        Fits to compare, such as hypotheses with and without a cause.
    fitted_before : sequence of Fit
        Fits to common data. The best of these is a further start, instead of the best
        other rival.
    min_gain : float
        A pass that gains less log evidence is the last.

    Returns
    -------
    list of Fit
        In the order of the rivals.
    """

    def fit_rival(number: int) -> Fit:
        rival = rivals[number]
        others = [other for other in rivals if other is not rival]
        best = max(fitted_before or others, key=lambda other: other.log_evidence)
        at_rival = prepared_at(prepared, rival)
        start = _find_start(at_rival, rival, best, min_gain)
        return _refine_with_own_error(at_rival, start, min_gain)

    return fit_in_workers(fit_rival, [rival.hypothesis for rival in rivals])


def _find_start(
    prepared: PreparedData, rival: Fit, best: Fit, min_gain: float
) -> EvaluatedFit:
    """Return the better of a rival at its optimum and of a fit from elsewhere.

    The latter starts from the shared parameters of the best other rival, and from other
    places and times.
    """
    at_optimum = evaluate_with_own_error(prepared, rival, rival.chi)
    shared = rival.hypothesis.exponents_from(rival.exponents | best.exponents)
    alternatives = alternative_parameter_starts(at_optimum.data, at_optimum.fit)
    starts = np.stack([shared, *alternatives])  # (C, P)
    chi = _find_best(at_optimum, starts, min_gain)
    elsewhere = evaluate_with_own_error(prepared, rival, chi)
    return max(at_optimum, elsewhere, key=lambda option: option.fit.log_evidence)


def _refine_with_own_error(
    prepared: PreparedData, current: EvaluatedFit, min_gain: float
) -> Fit:
    """Alternate between a fit and the numerical error at its optimum.

    The solver predicts the error from its slopes. If the log-likelihood with the real
    error differs from the predicted one, the slopes are computed again.
    """
    hypothesis = current.fit.hypothesis
    prediction_error = 0.0  # of the log-likelihood, in the last pass
    missed_gain = 0.0  # that the last pass predicted
    for _ in range(MAX_PASSES):
        if prediction_error > min_gain:
            prepared = prepared_at(prepared, current.fit)
            chi = current.fit.chi
            current = evaluate_with_own_error(prepared, current.fit, chi)
        chi = _find_best(current, current.fit.chi[None], min_gain)
        predicted = log_likelihoods(current.data, hypothesis, chi[None]).sum()
        moved = evaluate_with_own_error(prepared, current.fit, chi)
        gain = moved.fit.log_evidence - current.fit.log_evidence
        prediction_error = abs(moved.fit.log_likelihood_by_trial.sum() - predicted)
        if gain > 0:
            current = moved
        missed_gain = predicted - current.fit.log_likelihood_by_trial.sum()
        if max(gain, prediction_error) < min_gain:
            break
    error = max(current.fit.log_evidence_error, missed_gain)
    return replace(current.fit, log_evidence_error=error)


def prepared_at(prepared: PreparedData, rival: Fit) -> PreparedData:
    """Compute the change of numerical error with the parameters at a rival."""
    if prepared.mesh_is_model:
        return prepared
    mesh_correction = fit_mesh_correction(prepared, rival)
    data = replace(prepared.data, mesh_correction=mesh_correction)
    return replace(prepared, data=data)


@dataclass(frozen=True)
class EvaluatedFit:
    """A fit, and the data from which its numerical error is subtracted."""

    data: TrialData
    fit: Fit


def evaluate_with_own_error(
    prepared: PreparedData, fit: Fit, chi: np.ndarray
) -> EvaluatedFit:
    """Evaluate a hypothesis at exponents (P,), with the numerical error there."""
    moved = replace(fit, chi=chi)
    data = correct_data_on_one_finer_mesh(prepared, moved)
    data = with_random_effects(data, fit.hypothesis, chi)
    return EvaluatedFit(data, evaluate_fit(data, fit.hypothesis, chi, fit.width))


def _find_best(
    current: EvaluatedFit, starts: np.ndarray, min_gain: float
) -> np.ndarray:
    """Find the best exponents (P,) of a fit's hypothesis from starts (C, P)."""
    fit = current.fit
    chi, _ = best_exponents(
        current.data, fit.hypothesis, starts, fit.grid_points, min_gain, fit.width
    )
    return chi
