"""Confirmation of accepted causes by left-out trials; the others are set aside."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.evidence.agreement import probability_by_agreement
from stringcast.stages.diagnose.evidence.measures import (
    mean_explained_fraction,
    refit,
    tip_shift_rms,
    trials_touched_by,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.evidence.predictions import (
    TrialPrediction,
    log_likelihood_gains,
    predict_trials,
    tip_errors,
)
from stringcast.stages.diagnose.rules import (
    Criteria,
    is_inside_range,
    is_large_enough,
    predicts_heldout,
    trials_agree,
)
from stringcast.stages.diagnose.search.selection_state import SelectionState, with_fit
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

log = logging.getLogger(__name__)

AT_RANGE_END = "it is at the end of its range, probably a stand-in for another cause"
MIN_DISAGREEING_TRIALS = 3  # the scatter of two estimates has one degree of freedom


def drop_unconfirmed_causes(
    state: SelectionState,
    criteria: Criteria,
    candidates: int,
) -> SelectionState:
    """Set aside causes that left-out trials do not confirm, the last one first.

    If they confirm a rival, it replaces the cause.

    candidates: number of effects that share the prior probability of one being active.
    """
    state = _set_aside_small_causes(state, criteria)
    for cause in reversed(state.nameable_causes):
        without = _without_cause(state, cause)
        reason = _reason_to_set_aside(state, without, cause, criteria, candidates)
        if not reason:
            continue
        log.info("%s is set aside: %s", cause.name, reason)
        rival = _find_confirmed_rival(state, without, cause, criteria, candidates)
        state = rival or with_fit(state, without.fit)
        state = replace(state, set_aside={**state.set_aside, cause.name: reason})
    if state.unnamed and not state.nameable_causes:
        base = Hypothesis(state.fit.hypothesis.base)
        fit = refit(state.prepared.data, state.fit, base)
        state = replace(with_fit(state, fit), unnamed=())
    return state


def _without_cause(state: SelectionState, cause: type[Effect]) -> SelectionState:
    """Refit a state without one of its causes, to the same data."""
    hypothesis = state.fit.hypothesis.without_cause(cause)
    return replace(state, fit=refit(state.prepared.data, state.fit, hypothesis))


def _find_confirmed_rival(
    state: SelectionState,
    without: SelectionState,
    cause: type[Effect],
    criteria: Criteria,
    candidates: int,
) -> SelectionState | None:
    """Find the most evident rival of a cause that left-out trials confirm.

    Parameters
    ----------
    without : SelectionState
        The state without the cause.
    candidates : int
        Number of effects that share the prior probability of one being active.
    """
    for rival in _rivals_when_accepted(state, cause):
        other = rival.hypothesis.causes[-1]
        hypothesis = without.fit.hypothesis.with_cause(other)
        start = hypothesis.exponents_from(rival.exponents | without.fit.exponents)
        fit = fit_hypothesis(
            state.prepared.data, hypothesis, start[None], state.fit.grid_points
        )
        exchanged = with_fit(state, fit)
        again_without = _without_cause(exchanged, other)
        if not _reason_to_set_aside(
            exchanged, again_without, other, criteria, candidates
        ):
            log.info("%s takes its place", other.name)
            return replace(exchanged, replaced=(*state.replaced, cause))
    return None


def _rivals_when_accepted(state: SelectionState, cause: type[Effect]) -> list[Fit]:
    """Return the rivals with which a cause was compared when it was accepted."""
    for step in state.steps:
        compared = [fit.hypothesis.causes[-1] for fit in step.compared]
        if step.accepted and cause in compared:
            taken = state.fit.hypothesis.causes
            return [f for f in step.compared if f.hypothesis.causes[-1] not in taken]
    return []


def _set_aside_small_causes(
    state: SelectionState, criteria: Criteria
) -> SelectionState:
    """Set aside causes that are small given the others; they stay in the fit."""
    data = state.prepared.data
    reasons = dict(state.set_aside)
    small = []
    for cause in state.unnamed:
        if cause not in state.fit.hypothesis.causes:
            continue
        without = _without_cause(state, cause)
        reason = reason_if_small(data, without.fit, state.fit, criteria)
        if reason:
            reasons[cause.name] = reason
            small.append(cause)
    return replace(state, set_aside=reasons, unnamed=tuple(small))


def _reason_to_set_aside(
    state: SelectionState,
    without: SelectionState,
    cause: type[Effect],
    criteria: Criteria,
    candidates: int,
) -> str:
    """Return the reason why a cause is not confirmed; empty if it is.

    without: the state without this cause.
    """
    data = state.prepared.data
    fit = state.fit
    if not is_inside_range(fit, cause):
        return AT_RANGE_END
    if len(data.trials) < 2:
        return ""
    # No other trial can confirm a cause that acts in one trial only
    touched = trials_touched_by(data, fit, cause, criteria.tip_tolerance_m)
    acts_alone = len(touched) == 1
    if not acts_alone and not _predicts_trials(state, without, cause, criteria):
        return "it does not help to predict trials left out"
    if unexplained_tip_rms(data, fit).max() < criteria.tip_tolerance_m:
        return ""  # no misfit remains, so the evidence is reliable
    if acts_alone:
        return "it acts in one trial, which no other confirms, and misfit remains"
    disagree = _trials_disagree(state, cause, criteria, candidates)
    return "the trials do not agree on it" if disagree else ""


def _trials_disagree(
    state: SelectionState,
    cause: type[Effect],
    criteria: Criteria,
    candidates: int,
) -> bool:
    """Return whether three trials or more do not agree on a cause."""
    if len(state.prepared.data.trials) < MIN_DISAGREEING_TRIALS:
        return False
    probability = probability_by_agreement(
        state, cause, candidates, criteria.tip_tolerance_m
    )
    return not trials_agree(probability)


def _predicts_trials(
    state: SelectionState,
    without: SelectionState,
    cause: type[Effect],
    criteria: Criteria,
) -> bool:
    """Return whether a cause improves predictions of left-out trials.

    First, the fit to all trials without the cause is used in place of its predictions.
    It explains trials better than it predicts them. Most causes are confirmed even so,
    which saves the fits without each trial.
    """
    data = state.prepared.data
    fitted = predict_trials(data, without.fit)
    if _are_predicted_better(state, fitted, cause, criteria):
        return True
    return _are_predicted_better(state, without.predictions, cause, criteria)


def _are_predicted_better(
    state: SelectionState,
    others: Sequence[TrialPrediction],
    cause: type[Effect],
    criteria: Criteria,
) -> bool:
    """Return whether the state predicts left-out trials better than others do.

    others: predictions of each trial without the cause.
    """
    data = state.prepared.data
    gains = log_likelihood_gains(others, state.predictions)
    log.info("%s: predictive log-likelihoods %s", cause.name, np.round(gains, 1))
    explained = mean_explained_fraction(
        tip_errors(data, others),
        tip_errors(data, state.predictions),
        criteria.tip_tolerance_m,
    )
    log.info("%s: explains %.2f at tips of trials left out", cause.name, explained)
    return predicts_heldout(gains, explained)


def reason_if_small(data: TrialData, parent: Fit, fit: Fit, criteria: Criteria) -> str:
    """Return the reason why the last cause of a fit is small; empty if it is not."""
    if is_large_enough(data, parent, fit, criteria):
        return ""
    shift_mm = MM_PER_M * tip_shift_rms(data, parent, fit).max()
    return f"small: it moves the tip by {shift_mm:.1f} mm, less than the tolerance"
