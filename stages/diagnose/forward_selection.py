"""Forward selection of causes by Bayes factors, as a sum of single effects (SuSiE).

For every cause in the sum all candidates compete, and none among them; candidates that
explain as much as the best stay as its look-alikes (Wang, Sarkar, Carbonetto, Stephens,
J. R. Stat. Soc. B 82, 1273, 2020). The rules are in `rules`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.agreement import probability_by_agreement
from stringcast.stages.diagnose.base_model import refit_from_new_starts
from stringcast.stages.diagnose.candidate_comparison import (
    SelectionStep,
    by_evidence,
    compare_candidates,
    fit_roughly,
    rank_rivals,
    refine_fit,
)
from stringcast.stages.diagnose.common_data import fit_to_common_data
from stringcast.stages.diagnose.discretisation import (
    correct_discretisation_once,
    without_trials,
)
from stringcast.stages.diagnose.left_out_fits import groups_to_leave_out
from stringcast.stages.diagnose.measures import (
    mean_explained_fraction,
    refit,
    tip_shift_rms,
    trials_touched_by,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.noise import reestimate_noise
from stringcast.stages.diagnose.predictions import (
    TrialPrediction,
    log_likelihood_gains,
    predict_left_out_trials,
    tip_errors,
)
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.rules import (
    NEGLIGIBLE_LOG_EVIDENCE,
    STRONG_LOG_EVIDENCE,
    Criteria,
    has_evidence,
    is_evident,
    is_inside_range,
    is_needed,
    is_resolved,
    moves_tip_enough,
    predicts_heldout,
    trials_agree,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SelectionState:
    """State of a search for causes.

    Attributes
    ----------
    prepared : PreparedData
        Corrected at the fit.
    fit : Fit
        With all causes accepted so far.
    steps : sequence of SelectionStep
        The choices on the way; the last one may have accepted nothing.
    set_aside : dict
        Causes that were accepted and then dropped, with the reason.
    small : tuple of type of Effect
        Causes in the fit that move the tip too little to be named. They stay, as the
        values of others depend on them.
    """

    prepared: PreparedData
    fit: Fit
    steps: Sequence[SelectionStep] = ()
    set_aside: Mapping[str, str] = field(default_factory=dict)
    small: tuple[type[Effect], ...] = ()

    @property
    def large_causes(self) -> list[type[Effect]]:
        """The causes of the fit that are not small."""
        causes = self.fit.hypothesis.causes
        return [cause for cause in causes if cause not in self.small]

    @cached_property
    def predictions(self) -> list[TrialPrediction]:
        """Each trial as the fit to the others predicts it."""
        return predict_left_out_trials(self.prepared.data, self.fit)

    @property
    def left_out_exponents(self) -> list[np.ndarray]:
        """Exponents (P,) of the fit without each group of trials."""
        groups = groups_to_leave_out(len(self.prepared.data.trials))
        return [self.predictions[group[0]].chi for group in groups]


def select_causes(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    starts: int,
) -> Iterator[SelectionState]:
    """Add one cause at a time to a state while the evidence supports it.

    Yields the state after each cause, and at the end the state without causes that
    trials left out do not confirm.
    """
    for number in range(len(state.large_causes), criteria.max_causes):
        rng = np.random.default_rng([seed, number])
        state = _add_step(state, effects, criteria, seed)
        if _hides_others(state, criteria):
            small = _add_small_cause(state, criteria, rng, starts)
            small = _add_step(small, effects, criteria, seed)
            state = small if small.steps[-1].accepted else state
        step = state.steps[-1]
        if step.best is None or not step.accepted:
            state = _set_aside_if_small(state, step, criteria)
            break
        state = add_cause(state, step.best, criteria, rng, starts)
        state = drop_redundant_causes(state, step.best, criteria)
        state = exchange_causes_for_rivals(state)
        name = step.best.hypothesis.cause_names[-1]
        gain = step.best.log_evidence - step.parent.log_evidence
        log.info("accepted: %s, log evidence %+.1f", name, gain)
        yield state
    yield drop_unconfirmed_causes(state, criteria, len(effects))


def _add_step(
    state: SelectionState,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
) -> SelectionState:
    """Compare all candidates for one more cause.

    Candidates may lead to a better fit without a further cause, which is taken.
    """
    step = compare_candidates(state.prepared, state.fit, effects, criteria, seed)
    parent = step.parent
    if not step.accepted and parent is not state.fit:
        data = state.prepared.data
        moved = evaluate_fit(data, parent.hypothesis, parent.chi, parent.width)
        if moved.log_evidence > state.fit.log_evidence + NEGLIGIBLE_LOG_EVIDENCE:
            state = with_fit(state, moved)
    return replace(state, steps=(*state.steps, step))


def _hides_others(state: SelectionState, criteria: Criteria) -> bool:
    """Whether the best cause of the last step is evident, small, and not alone.

    What moves the tip less than counts may be more evident than what moves it more,
    such as a small offset of the clocks in fast motions.
    """
    data = state.prepared.data
    step = state.steps[-1]
    if step.best is None or moves_tip_enough(data, step.parent, step.best, criteria):
        return False
    if unexplained_tip_rms(data, step.best).max() < criteria.tip_tolerance_m:
        return False
    return is_evident(data, step.parent, step.best, criteria)


def _add_small_cause(
    state: SelectionState,
    criteria: Criteria,
    rng: np.random.Generator,
    starts: int,
) -> SelectionState:
    """Add the best cause of the last step, so that others are sought besides it."""
    best = state.steps[-1].best
    assert best is not None
    cause = best.hypothesis.causes[-1]
    log.info("%s is small; others are sought in addition to it", cause.name)
    state = add_cause(state, best, criteria, rng, starts)
    return replace(state, small=(*state.small, cause))


def _set_aside_if_small(
    state: SelectionState,
    step: SelectionStep,
    criteria: Criteria,
) -> SelectionState:
    """Set aside the best cause of a step that is evident and hardly moves the tip."""
    data = state.prepared.data
    best = step.best
    if best is None or not has_evidence(step.parent, best, criteria):
        return state
    reason = _reason_if_small(data, step.parent, best, criteria)
    if not reason:
        return state
    name = best.hypothesis.cause_names[-1]
    return replace(state, set_aside={**state.set_aside, name: reason})


def _reason_if_small(data: TrialData, parent: Fit, fit: Fit, criteria: Criteria) -> str:
    """Say by how little a fit moves the tip from its parent, or nothing."""
    if moves_tip_enough(data, parent, fit, criteria):
        return ""
    shift_mm = MM_PER_M * tip_shift_rms(data, parent, fit).max()
    return f"small: it moves the tip by {shift_mm:.1f} mm, less than the tolerance"


def with_fit(state: SelectionState, fit: Fit) -> SelectionState:
    """Replace the fit of a state by another one, refined.

    Causes that come in are no longer set aside.
    """
    refined = refine_fit(state.prepared, fit)
    before = state.fit.hypothesis.cause_names
    added = set(fit.hypothesis.cause_names).difference(before)
    set_aside = {n: r for n, r in state.set_aside.items() if n not in added}
    return replace(
        state, prepared=refined.prepared, fit=refined.fit, set_aside=set_aside
    )


def add_cause(
    state: SelectionState,
    best: Fit,
    criteria: Criteria,
    rng: np.random.Generator,
    starts: int,
) -> SelectionState:
    """Take a fit with more causes, with noise and numerical error as they are there."""
    with_noise = reestimate_noise(state.prepared, best)
    joined = correct_discretisation_once(with_noise, best)
    prepared = joined.prepared
    fit = joined.fit
    steps = state.steps
    if with_noise.point_counts != state.prepared.point_counts:
        counts = with_noise.outlier_count, state.prepared.outlier_count
        log.info("%d outliers instead of %d", *counts)
        steps = [_refit_step(prepared.data, step, criteria) for step in steps]

    # Search more widely if much is left. Other strings are no better if their trials
    # are resolved worse: what is uncertain in these may explain anything.
    if unexplained_tip_rms(prepared.data, fit).max() > criteria.tip_tolerance_m:
        other = refit_from_new_starts(prepared.data, fit, rng, starts)
        refined = refine_fit(prepared, other)
        uncertainty_m = refined.prepared.discretisation_uncertainty_m
        before_m = prepared.discretisation_uncertainty_m
        is_better = refined.fit.log_evidence > fit.log_evidence
        if is_better and is_resolved(
            uncertainty_m, before_m, criteria, needed=len(before_m)
        ):
            prepared = refined.prepared
            fit = refined.fit
    return replace(state, prepared=prepared, fit=fit, steps=steps)


def _refit_step(
    data: TrialData, step: SelectionStep, criteria: Criteria
) -> SelectionStep:
    """Move a step to data with other points: compared fits are refitted."""
    parent = refit(data, step.parent, step.parent.hypothesis)
    compared = [refit(data, fit, fit.hypothesis) for fit in step.compared]
    was_compared = {id(fit) for fit in step.compared}  # fits hold arrays: no equality
    others = []
    for fit in step.fits:
        if id(fit) not in was_compared:
            others.append(evaluate_fit(data, fit.hypothesis, fit.chi))
    fits = rank_rivals(parent, [*compared, *others], criteria)
    unresolved = [refit(data, fit, fit.hypothesis) for fit in step.unresolved]
    # All are now on the same data
    return replace(
        step,
        data=data,
        parent=parent,
        fits=fits,
        compared=compared,
        unresolved=unresolved,
    )


def with_causes_found_before(
    prepared: PreparedData,
    found: SelectionState,
    criteria: Criteria,
    seed: int,
    starts: int,
) -> SelectionState:
    """Fit the causes that were found in fewer trials to the prepared ones."""
    base = prepared.base_fit
    hypothesis = Hypothesis(base.hypothesis.base, found.fit.hypothesis.causes)
    # By values: the ranges may be others with more trials
    known = {}
    values = found.fit.values
    for parameter in hypothesis.parameters:
        if parameter.name in values:
            value = np.asarray(values[parameter.name])
            known[parameter.name] = float(parameter.chi(value))
    start = hypothesis.exponents_from(known)
    fit = fit_hypothesis(prepared.data, hypothesis, start[None], base.scale_indices)
    rng = np.random.default_rng(seed)
    state = SelectionState(prepared, base, small=found.small)
    return add_cause(state, fit, criteria, rng, starts)


def without_chaotic_trials(
    state: SelectionState, names: Sequence[str], criteria: Criteria
) -> SelectionState:
    """Leave out trials that are chaotic, and causes that only these need."""
    is_kept = [trial.name not in names for trial in state.prepared.data.trials]
    prepared = without_trials(state.prepared, names)
    before = state.fit
    scale_indices = before.scale_indices[is_kept]
    fit = fit_hypothesis(
        prepared.data, before.hypothesis, before.chi[None], scale_indices
    )
    refined = refine_fit(prepared, fit)
    remaining = SelectionState(refined.prepared, refined.fit, small=state.small)
    return drop_redundant_causes(remaining, refined.fit, criteria)


def drop_redundant_causes(
    state: SelectionState,
    best: Fit,
    criteria: Criteria,
) -> SelectionState:
    """Drop causes that the evidence does not need any more, the new one included.

    best: the fit with all of them, in the order of acceptance.
    """
    for cause in best.hypothesis.causes:
        data = state.prepared.data
        hypothesis = state.fit.hypothesis.without_cause(cause)
        without = refit(data, state.fit, hypothesis)
        if not is_needed(without, state.fit, criteria):
            log.info("%s is dropped: the evidence does not need it", cause.name)
            state = with_fit(state, without)
    return state


def exchange_causes_for_rivals(state: SelectionState) -> SelectionState:
    """Replace causes by close rivals if these go better with the later causes.

    As sequential replacement does in the selection of variables (Miller, Subset
    Selection in Regression, 2002, section 3.3). Rivals that are about as evident when
    one of them is accepted may differ by a hundred once another cause is there.
    """
    for step in state.steps[:-1]:
        causes = state.fit.hypothesis.causes
        close = [
            fit
            for fit in step.compared
            if fit.log_evidence > step.compared[0].log_evidence - STRONG_LOG_EVIDENCE
        ]
        present = [fit for fit in close if fit.hypothesis.causes[-1] in causes]
        absent = [fit for fit in close if fit.hypothesis.causes[-1] not in causes]
        if len(present) == 1:
            cause = present[0].hypothesis.causes[-1]
            state = _exchange_for_best(state, cause, absent)
    return state


def _exchange_for_best(
    state: SelectionState, cause: type[Effect], rivals: Sequence[Fit]
) -> SelectionState:
    """Replace a cause by that of the rival with most evidence, if that exceeds its."""
    if not rivals:
        return state
    others = state.fit.hypothesis.without_cause(cause)
    fits = [state.fit]
    for rival in rivals:
        hypothesis = others.with_cause(rival.hypothesis.causes[-1])
        start = hypothesis.exponents_from(rival.exponents | state.fit.exponents)
        fit = fit_roughly(state.prepared.data, hypothesis, start[None], state.fit)
        fits.append(fit)
    before, *compared = fit_to_common_data(state.prepared, fits)
    best = by_evidence(compared)[0]
    gain = best.log_evidence - before.log_evidence
    if gain < NEGLIGIBLE_LOG_EVIDENCE:
        return state
    other = best.hypothesis.causes[-1]
    log.info("%s instead of %s: log evidence %+.1f", other.name, cause.name, gain)
    return with_fit(state, best)


def drop_unconfirmed_causes(
    state: SelectionState,
    criteria: Criteria,
    candidates: int,
) -> SelectionState:
    """Set aside causes that trials left out do not confirm, the last one first.

    candidates: number of effects that share the prior probability of one being active.
    """
    state = _set_aside_small_causes(state, criteria)
    for cause in reversed(state.large_causes):
        hypothesis = state.fit.hypothesis.without_cause(cause)
        without = replace(state, fit=refit(state.prepared.data, state.fit, hypothesis))
        reason = _reason_to_set_aside(state, without, cause, criteria, candidates)
        if reason:
            log.info("%s is set aside: %s", cause.name, reason)
            reasons = {**state.set_aside, cause.name: reason}
            state = replace(with_fit(state, without.fit), set_aside=reasons)
    if state.small and not state.large_causes:
        base = Hypothesis(state.fit.hypothesis.base)
        fit = refit(state.prepared.data, state.fit, base)
        state = replace(with_fit(state, fit), small=())
    return state


def _set_aside_small_causes(
    state: SelectionState, criteria: Criteria
) -> SelectionState:
    """Say which causes of the fit are small, given the others; they stay in it."""
    data = state.prepared.data
    reasons = dict(state.set_aside)
    small = []
    for cause in state.small:
        if cause not in state.fit.hypothesis.causes:
            continue
        hypothesis = state.fit.hypothesis.without_cause(cause)
        without = refit(data, state.fit, hypothesis)
        reason = _reason_if_small(data, without, state.fit, criteria)
        if reason:
            reasons[cause.name] = reason
            small.append(cause)
    return replace(state, set_aside=reasons, small=tuple(small))


def _reason_to_set_aside(
    state: SelectionState,
    without: SelectionState,
    cause: type[Effect],
    criteria: Criteria,
    candidates: int,
) -> str:
    """Say why a cause is not confirmed, or nothing if it is.

    without: the state without this cause.
    """
    data = state.prepared.data
    fit = state.fit
    if not is_inside_range(fit, cause):
        return "it is at the end of its range, probably a stand-in for another cause"
    if len(data.trials) < 2:
        return ""
    # No other trial can confirm what acts in one trial alone
    touched = trials_touched_by(data, fit, cause, criteria.tip_tolerance_m)
    acts_alone = len(touched) == 1
    if not acts_alone and not _predicts_trials(state, without, cause, criteria):
        return "it does not help to predict trials left out"
    if unexplained_tip_rms(data, fit).max() < criteria.tip_tolerance_m:
        return ""  # the model lacks nothing, and its evidence holds
    probability = probability_by_agreement(
        data,
        fit,
        state.left_out_exponents,
        cause,
        candidates,
        criteria.tip_tolerance_m,
    )
    log.info("%s: probability by agreement of trials %.2f", cause.name, probability)
    if trials_agree(probability):
        return ""
    return _reason_for_no_agreement(len(data.trials), acts_alone)


def _reason_for_no_agreement(trials: int, acts_alone: bool) -> str:
    """Say why a number of trials do not confirm a cause."""
    if acts_alone:
        return "it acts in one trial, which no other confirms, and misfit remains"
    if trials == 2:
        return "two trials are too few to confirm it, and misfit remains"
    return "the trials do not agree on it"


def _predicts_trials(
    state: SelectionState,
    without: SelectionState,
    cause: type[Effect],
    criteria: Criteria,
) -> bool:
    """Whether a cause helps to predict trials left out. Parameters as before."""
    data = state.prepared.data
    gains = log_likelihood_gains(without.predictions, state.predictions)
    log.info("%s: predictive log-likelihoods %s", cause.name, np.round(gains, 1))
    explained = mean_explained_fraction(
        tip_errors(data, without.predictions),
        tip_errors(data, state.predictions),
        criteria.tip_tolerance_m,
    )
    log.info("%s: explains %.2f at tips of trials left out", cause.name, explained)
    return predicts_heldout(gains, explained)
