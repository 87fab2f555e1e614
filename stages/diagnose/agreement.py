"""Whether the trials agree on a cause: a t-test of what each of them says.

A model that lacks something is sure of its parameters without reason: its likelihood
does not know what is missing. How far an estimate changes from trial to trial shows it.
What is estimated is by how much the cause moves the points, in the direction in which
it moves them in the fit to all trials: its parameters may trade off with each other.
Each group of trials is left out in turn, which gives the estimate a standard error
without a model of the misfit (jackknife over clusters [1]_). Its ratio to the estimate
is a t statistic with as many observations as groups, and its Bayes factor against an
absent cause that of a unit information prior [2]_. A cause that may vary between trials
is estimated with one amplitude for all of them: how far they differ is in the scatter.
Of a cause that acts in one trial alone the others say nothing: its estimate hardly
changes without them, and with one treated cluster such an error is far too small [3]_.
Its Bayes factor is 1.

References
----------
.. [1] MacKinnon, Nielsen, Webb, J. Econometrics 232, 272 (2023).
.. [2] Wagenmakers, Psychonomic Bulletin & Review 14, 779 (2007).
.. [3] MacKinnon, Webb, Econometrics Journal 21, 114 (2018).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.diagnose.left_out_fits import (
    exponents_without_groups,
    groups_to_leave_out,
)
from stringcast.stages.diagnose.measures import refit, trials_touched_by
from stringcast.stages.diagnose.probabilities import effect_probabilities
from stringcast.stages.diagnose.selection_state import SelectionState
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.solver import residual_changes
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

SMALLEST_ERROR = 1e-6  # of the estimate: some do not change at all


def log_bayes_factor_of_trials(
    data: TrialData,
    fit: Fit,
    left_out: Sequence[np.ndarray],
    cause: type[Effect],
) -> float:
    """Compare that a cause is there with that it is not, by estimates without trials.

    Parameters
    ----------
    left_out : sequence of numpy.ndarray, shape (P,)
        Exponents of the fit without each group of trials.
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
    """Simulate by how much a cause moves the points at exponents (C, P), white (C, N).

    It moves those of a simulation that diverges by nothing.
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
    """Compute the probability that a cause is there, by the trials' t-test alone.

    Parameters
    ----------
    candidates : int
        Number of effects that share the prior probability of one being active.
    min_tip_shift_m : float
        By which a cause that depends on place moves the tip where it acts [m].
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
    return effect_probabilities(log_evidence, candidates)["cause"]
