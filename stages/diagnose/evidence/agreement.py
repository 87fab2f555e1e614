"""Agreement of trials on a cause: a t-test by leaving out trials.

The likelihood of an incomplete model is overconfident. The scatter of an estimate
between trials is not. The estimate is the displacement of the points by the cause,
projected on that in the fit to all trials, because the parameters of the cause may be
correlated. Each group of trials is left out in turn. This gives a standard error
without a model of the misfit (jackknife over clusters [1]_), and a t statistic with as
many observations as groups. Its Bayes factor against an absent cause is that of a unit
information prior [2]_.

A cause that may vary between trials is estimated with one amplitude for all of them, so
that the scatter includes the variation. A cause that acts in a single trial has a Bayes
factor of 1: its estimate hardly changes without other trials, and with one treated
cluster the jackknife error is far too small [3]_.

References
----------
.. [1] MacKinnon, Nielsen, Webb, J. Econometrics 232, 272 (2023).
.. [2] Wagenmakers, Psychonomic Bulletin & Review 14, 779 (2007).
.. [3] MacKinnon, Webb, Econometrics Journal 21, 114 (2018).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from stringcast.stages.diagnose.evidence.left_out_fits import (
    exponents_without_groups,
    groups_to_leave_out,
)
from stringcast.stages.diagnose.evidence.measures import refit, trials_touched_by
from stringcast.stages.diagnose.evidence.probabilities import effect_probabilities
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.solver import residual_changes
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

log = logging.getLogger(__name__)

SMALLEST_ERROR = 1e-6  # of the estimate, in case it does not change at all


def log_bayes_factor_of_trials(
    data: TrialData,
    fit: Fit,
    left_out: Sequence[np.ndarray],
    cause: type[Effect],
) -> float:
    """Compute the log Bayes factor for a cause from estimates without some trials.

    Parameters
    ----------
    left_out : sequence of numpy.ndarray, shape (P,)
        Exponents of the fits without each group of trials.
    """
    chi = np.stack([fit.chi, *left_out])
    shifts = _white_shifts(data, fit, chi, cause)
    estimate, *others = shifts @ shifts[0]
    estimates = np.array(others)

    groups = len(estimates)
    amplitudes = len(fit.hypothesis.amplitude_indices(cause))
    scatter = np.sum((estimates - estimates.mean()) ** 2)
    error = np.sqrt((groups - 1) / groups * scatter)
    t = estimate / max(error, SMALLEST_ERROR * estimate)
    return float(
        0.5 * groups * np.log1p(t**2 / (groups - 1)) - 0.5 * amplitudes * np.log(groups)
    )


def _white_shifts(
    data: TrialData,
    fit: Fit,
    chi: np.ndarray,
    cause: type[Effect],
) -> np.ndarray:
    """Compute white displacements (C, N) by a cause at exponents (C, P).

    They are zero where a simulation diverges.
    """
    hypothesis = fit.hypothesis
    amplitudes = hypothesis.amplitude_indices(cause)
    absent = chi.copy()
    absent[:, amplitudes] = hypothesis.exponents_from({})[amplitudes]
    simulated = data.residuals(hypothesis.model, np.concatenate([chi, absent]))
    shifts = []
    for rows in simulated:
        present, without = np.split(rows, 2)
        shifts.append(residual_changes(present, without))
    return data.for_hypothesis(hypothesis).whiten(shifts, fit.grid_points)


def probability_by_agreement(
    state: SelectionState,
    cause: type[Effect],
    candidates: int,
    min_tip_shift_m: float,
) -> float:
    """Compute the probability of a cause from the t-test of trials alone.

    Parameters
    ----------
    candidates : int
        Number of effects that share the prior probability of one being active.
    min_tip_shift_m : float
        Tip shift above which a cause that depends on place acts in a trial [m].
    """
    data = state.prepared.data
    fit = state.fit
    log_bayes_factor = 0.0
    if len(trials_touched_by(data, fit, cause, min_tip_shift_m)) != 1:
        if cause.name in data.random_effects:
            data = data.without_random_effect(cause.name)
            fit = refit(data, fit, fit.hypothesis)
            groups = groups_to_leave_out(len(data.trials))
            left_out = exponents_without_groups(data, fit, groups)
        else:
            left_out = state.left_out_exponents
        log_bayes_factor = log_bayes_factor_of_trials(data, fit, left_out, cause)
    log_evidence = {"": np.zeros(1), "cause": np.array([log_bayes_factor])}
    probability = effect_probabilities(log_evidence, candidates)["cause"]
    log.info("%s: probability by agreement of trials %.2f", cause.name, probability)
    return probability
