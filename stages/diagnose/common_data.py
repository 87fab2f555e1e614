"""Evidence of rivals on the same data, each with the numerical error at its optimum.

A search subtracts the numerical error at the optimum of one fit from the measured
points. At the optimum of a rival this error is different. That changes log evidences by
up to hundreds, more than the differences between rivals. So each rival is fitted with
the error at its own optimum, until it does not move any more. Initial states, noise and
discrepancy are common to all.

A rival may be in a worse local minimum of the shared parameters. So it is also fitted
from those of the most evident other rival, and from other places and times where causes
may act. The more evident of both fits goes on. The slopes of the error are computed
again if the error changes differently from their prediction. The gain that the last
pass predicted but did not reach is an error of the log evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.diagnose.discrepancy_model import with_random_effects
from stringcast.stages.diagnose.discretisation import (
    correct_data_on_one_finer_mesh,
    fit_mesh_correction,
)
from stringcast.stages.diagnose.measures import fit_in_workers
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.proposals import alternative_parameter_starts
from stringcast.stages.diagnose.rules import NEGLIGIBLE_LOG_EVIDENCE
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
        searched = prepared_at(prepared, rival)
        current = evaluate_with_own_error(searched, rival, rival.chi)

        # Further starts
        exponents = rival.exponents | best.exponents
        shared = rival.hypothesis.exponents_from(exponents)
        alternatives = alternative_parameter_starts(current.data, current.fit)
        starts = np.stack([shared, *alternatives])
        moved_to = _find_best(current, starts, min_gain)
        alternative = evaluate_with_own_error(searched, rival, moved_to)
        if alternative.fit.log_evidence > current.fit.log_evidence:
            current = alternative

        surprise = 0.0  # error of the log-likelihood that the last pass predicted
        for _ in range(MAX_PASSES):
            if surprise > min_gain:
                # The slopes of the error are different here
                searched = prepared_at(prepared, current.fit)
                chi = current.fit.chi
                current = evaluate_with_own_error(searched, current.fit, chi)
            start = current.fit.chi[None]
            moved_to = _find_best(current, start, min_gain)
            by_trial = log_likelihoods(current.data, rival.hypothesis, moved_to[None])
            expected = by_trial.sum()
            moved = evaluate_with_own_error(searched, current.fit, moved_to)
            gain = moved.fit.log_evidence - current.fit.log_evidence
            found = moved.fit.log_likelihood_by_trial.sum()
            surprise = abs(found - expected)
            if gain > 0:
                current = moved
            missed = expected - current.fit.log_likelihood_by_trial.sum()
            if max(gain, surprise) < min_gain:
                break
        error = max(current.fit.log_evidence_error, missed)
        return replace(current.fit, log_evidence_error=error)

    return fit_in_workers(fit_rival, [rival.hypothesis for rival in rivals])


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
        current.data, fit.hypothesis, starts, fit.grid_points, min_gain
    )
    return chi
