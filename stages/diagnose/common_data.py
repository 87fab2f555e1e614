"""Evidence of rivals on the same data: each with the numerical error of its own end.

A search subtracts the numerical error at the optimum of a fit from what was measured.
How far this error is from that where a rival ends moves log evidences by up to
hundreds: more than rivals differ. So each rival is fitted in turn with the error that
belongs to where it has come to, until it stays there: it is then compared, with nothing
but its own simulation, on what was measured. Initial states, noise and discrepancy are
those of one search. A rival may be in a worse minimum of the parameters that all share,
so that it is also fitted from those of the most evident other one, and from other
places and times where causes may act. It goes on from the more evident end. How the
error changes is measured again where it changes otherwise than expected; what the last
pass promised and did not gain is an error of the log evidence.
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

MAX_PASSES = 4  # of a fit and its numerical error; it mostly takes two


def fit_to_common_data(
    prepared: PreparedData,
    rivals: Sequence[Fit],
    fitted_before: Sequence[Fit] = (),
    min_gain: float = NEGLIGIBLE_LOG_EVIDENCE,
) -> list[Fit]:
    """Fit each rival to what was measured.

    Parameters
    ----------
    prepared : PreparedData
        The data of the search, with their initial states and error models.
    rivals : sequence of Fit
        What is compared, such as hypotheses with and without a cause.
    fitted_before : sequence of Fit
        On common data; rivals begin also where the best of these is, and not where the
        best other rival is.
    min_gain : float
        Of the log evidence; a pass that gains less is the last.

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

        # Other places to begin from
        exponents = rival.exponents | best.exponents
        shared = rival.hypothesis.exponents_from(exponents)
        alternatives = alternative_parameter_starts(current.data, current.fit)
        starts = np.stack([shared, *alternatives])
        moved_to = _refit(current.data, current.fit, starts, min_gain)
        elsewhere = evaluate_with_own_error(searched, rival, moved_to)
        if elsewhere.fit.log_evidence > current.fit.log_evidence:
            current = elsewhere

        surprise = 0.0  # of the log-likelihood where the last pass ended
        for _ in range(MAX_PASSES):
            if surprise > min_gain:
                # The error changes otherwise than it did where the rival began
                searched = prepared_at(prepared, current.fit)
                chi = current.fit.chi
                current = evaluate_with_own_error(searched, current.fit, chi)
            start = current.fit.chi[None]
            moved_to = _refit(current.data, current.fit, start, min_gain)
            by_trial = log_likelihoods(current.data, rival.hypothesis, moved_to[None])
            expected = by_trial.sum()
            moved = evaluate_with_own_error(searched, current.fit, moved_to)
            gain = moved.fit.log_evidence - current.fit.log_evidence
            found = moved.fit.log_likelihood_by_trial.sum()
            surprise = abs(found - expected)
            if gain > 0:
                current = moved
            # Of what the pass promised
            missed = expected - current.fit.log_likelihood_by_trial.sum()
            if max(gain, surprise) < min_gain:
                break
        error = max(current.fit.log_evidence_error, missed)
        return replace(current.fit, log_evidence_error=error)

    return fit_in_workers(fit_rival, [rival.hypothesis for rival in rivals])


def prepared_at(prepared: PreparedData, rival: Fit) -> PreparedData:
    """Measure how the numerical error changes with the parameters about a rival."""
    if prepared.mesh_is_model:
        return prepared
    mesh_correction = fit_mesh_correction(prepared, rival)
    data = replace(prepared.data, mesh_correction=mesh_correction)
    return replace(prepared, data=data)


@dataclass(frozen=True)
class EvaluatedFit:
    """A fit, and the data with the numerical error of where it is subtracted."""

    data: TrialData
    fit: Fit


def evaluate_with_own_error(
    prepared: PreparedData, fit: Fit, chi: np.ndarray
) -> EvaluatedFit:
    """Evaluate the hypothesis of a fit at exponents (P,), with its error there."""
    moved = replace(fit, chi=chi)
    data = correct_data_on_one_finer_mesh(prepared, moved)
    data = with_random_effects(data, fit.hypothesis, chi)
    return EvaluatedFit(data, evaluate_fit(data, fit.hypothesis, chi, fit.width))


def _refit(
    data: TrialData, fit: Fit, starts: np.ndarray, min_gain: float
) -> np.ndarray:
    """Find where a fit moves from exponents (C, P) on some data."""
    chi, _ = best_exponents(data, fit.hypothesis, starts, fit.grid_points, min_gain)
    return chi
