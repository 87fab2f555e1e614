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

from stringcast.stages.diagnose.agreement import probability_by_agreement
from stringcast.stages.diagnose.base_model import refit_from_new_starts
from stringcast.stages.diagnose.common_data import fit_to_common_data
from stringcast.stages.diagnose.discretisation import (
    correct_data_on_one_finer_mesh,
    correct_discretisation_once,
)
from stringcast.stages.diagnose.left_out_fits import groups_to_leave_out
from stringcast.stages.diagnose.measures import (
    mean_explained_fraction,
    refit,
    sample_by_misfit,
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
from stringcast.stages.diagnose.prepared_data import PreparedData, RefinedFit
from stringcast.stages.diagnose.proposals import (
    Proposal,
    alternative_parameter_starts,
    propose_causes,
)
from stringcast.stages.diagnose.rules import (
    MIN_RESOLVED_TRIALS,
    NEGLIGIBLE_LOG_EVIDENCE,
    STRONG_LOG_EVIDENCE,
    Criteria,
    has_evidence,
    is_evident,
    is_inside_range,
    is_needed,
    is_resolved,
    is_supported,
    moves_tip_enough,
    predicts_heldout,
    trials_agree,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect
from stringcast.stages.workers import map_in_workers

log = logging.getLogger(__name__)

INITIAL_PROPOSALS = 6  # the others are fitted if none of these explains what is left
MM_PER_M = 1e3
MAX_RIVALS = 3  # that are refined in one step
MAX_SAMPLED_TRIALS = 8  # candidates are tried in these before all
UNRESOLVED_FRACTION = 0.1  # of a trial's mean square misfit that may stay unresolved


@dataclass(frozen=True)
class SelectionStep:
    """Comparison of all candidates for one more cause.

    Attributes
    ----------
    data : TrialData
        That the parent and the leading fits are fitted to, but for numerical error.
    parent : Fit
        Without the cause to be chosen.
    proposals : sequence of Proposal
        Of all candidates, the most promising first.
    fits : sequence of Fit
        Of those fitted, as of `rank_rivals`.
    refined : sequence of Fit
        Those of them near the leading one. Several of them and their parent are fitted
        to the same data (`common_data`).
    accepted : bool
        Whether the best is accepted.
    unresolved : sequence of Fit
        Those that have as much evidence as the best when refined, but by which too few
        trials can be simulated. They cannot be distinguished from it.
    """

    data: TrialData
    parent: Fit
    proposals: Sequence[Proposal]
    fits: Sequence[Fit]
    refined: Sequence[Fit] = ()
    accepted: bool = False
    unresolved: Sequence[Fit] = ()

    @property
    def best(self) -> Fit | None:
        """The fit that leads."""
        return self.fits[0] if self.fits else None


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
    """Compare all candidates for one more cause."""
    step = compare_candidates(state.prepared, state.fit, effects, criteria, seed)
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


def compare_candidates(
    prepared: PreparedData,
    parent: Fit,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    contested: Fit | None = None,
) -> SelectionStep:
    """Fit what each effect may add to a parent, and decide on the best of them.

    Parameters
    ----------
    contested : Fit, optional
        The refined fit of a cause that was accepted, whose place is contested.
    """
    causes = parent.hypothesis.causes
    candidates = [effect for effect in effects if effect not in causes]
    sample, sampled_parent = _sample_trials(prepared.data, parent)
    proposals = propose_causes(sample, sampled_parent, candidates, seed)
    step = SelectionStep(prepared.data, parent, proposals, fits=())
    remaining = proposals
    if contested is not None:
        step = replace(step, fits=(contested,))
        causes = contested.hypothesis.causes
        remaining = [p for p in proposals if p.effect not in causes]

    # The most promising ones, and the look-alikes of the best of these
    first = [p for p in remaining[:INITIAL_PROPOSALS] if p.gain > STRONG_LOG_EVIDENCE]
    step = _fit_more_proposals(prepared, step, first, criteria)
    remaining = [p for p in remaining if p not in first]
    lookalikes = _lookalikes_of_best(step, remaining, criteria)
    step = _fit_more_proposals(prepared, step, lookalikes, criteria)
    refined = _refine_rivals(prepared, step, criteria, contested)

    # All others, if something is left to explain
    misfit_m = unexplained_tip_rms(prepared.data, parent).max()
    if not refined.accepted and misfit_m > criteria.tip_tolerance_m:
        others = [p for p in remaining if p not in lookalikes]
        step = _fit_more_proposals(prepared, step, others, criteria)
        refined = _refine_rivals(prepared, step, criteria, contested)
    return refined


def _sample_trials(data: TrialData, parent: Fit) -> tuple[TrialData, Fit]:
    """Sample the trials in which candidates are first tried, if that halves them."""
    if len(data.trials) < 2 * MAX_SAMPLED_TRIALS:
        return data, parent
    chosen = sample_by_misfit(data, parent, MAX_SAMPLED_TRIALS)
    sample = data.subset(chosen)
    return sample, evaluate_fit(sample, parent.hypothesis, parent.chi, parent.width)


def _lookalikes_of_best(
    step: SelectionStep,
    others: Sequence[Proposal],
    criteria: Criteria,
) -> list[Proposal]:
    """Find proposals that to first order explain much of what the best fit does."""
    if step.best is None or not has_evidence(step.parent, step.best, criteria):
        return []
    effect = step.best.hypothesis.causes[-1]
    least = criteria.min_explained_fraction
    for best in step.proposals:
        if best.effect is effect:
            return [p for p in others if p.cosine_similarity(best) ** 2 > least]
    return []


def _refine_rivals(
    prepared: PreparedData,
    step: SelectionStep,
    criteria: Criteria,
    contested: Fit | None,
) -> SelectionStep:
    """Refine the fits near the best one, and decide whether the best is accepted.

    Rivals by which simulation resolves too few trials cannot lead: what is uncertain in
    the others may explain anything.
    """
    parent = step.parent
    if step.best is None or not has_evidence(parent, step.best, criteria):
        return step
    least_evidence = _least_evidence(step.fits, parent, criteria)
    count = sum(fit.log_evidence > least_evidence for fit in step.fits[:MAX_RIVALS])

    needed = len(prepared.discretisation_uncertainty_m)
    allowance_m = np.zeros(needed)
    if contested is None:
        needed = min(MIN_RESOLVED_TRIALS, needed)
        # A fraction of mean squares, and the roots of both
        misfit_m = unexplained_tip_rms(prepared.data, parent)
        allowance_m = np.sqrt(UNRESOLVED_FRACTION) * misfit_m

    def refine_rival(fit: Fit) -> tuple[Fit, bool]:
        rival = RefinedFit(prepared, fit)
        if fit is not contested:
            rival = refine_fit(prepared, fit)
        resolved = is_resolved(rival.prepared, prepared, criteria, needed, allowance_m)
        return rival.fit, resolved

    # Refinement mostly lowers the evidence: none may lead because it was not refined
    refined: list[Fit] = []
    unresolved: list[Fit] = []
    unrefined = list(step.fits)
    while count:
        chosen = unrefined[:count]
        unrefined = unrefined[count:]
        answers = map_in_workers(refine_rival, chosen)
        for rival, (fit, resolved) in zip(chosen, answers, strict=True):
            # A worker returns a copy of the hypothesis
            own = replace(fit, hypothesis=rival.hypothesis)
            (refined if resolved else unresolved).append(own)
        refined = rank_rivals(parent, refined, criteria)
        count = int(_is_overtaken(parent, refined, unrefined, criteria))
    ahead = []
    for fit in unresolved:
        if refined and fit.log_evidence >= refined[0].log_evidence:
            name = fit.hypothesis.cause_names[-1]
            log.info("%s cannot be simulated well enough to be told apart", name)
            ahead.append(fit)

    if len(refined) > 1:
        parent, *fits = fit_to_common_data(prepared, [parent, *refined])
        refined = rank_rivals(parent, fits, criteria)
        for fit in refined:
            name = fit.hypothesis.cause_names[-1]
            gain = fit.log_evidence - parent.log_evidence
            log.info("on common data: %s, log evidence %+.1f", name, gain)

    every_fit = [*refined, *unrefined]
    is_accepted = bool(every_fit) and is_supported(
        prepared.data, parent, every_fit[0], criteria
    )
    return replace(
        step,
        parent=parent,
        fits=every_fit,
        refined=refined,
        accepted=is_accepted,
        unresolved=ahead,
    )


def _is_overtaken(
    parent: Fit,
    refined: Sequence[Fit],
    unrefined: Sequence[Fit],
    criteria: Criteria,
) -> bool:
    """Whether the first of the unrefined fits clearly leads the refined ones."""
    if not unrefined:
        return False
    other = unrefined[0]
    if not refined:
        return has_evidence(parent, other, criteria)
    best = refined[0]
    leads = rank_rivals(parent, [best, other], criteria)[0] is other
    # With less evidence it leads because the best is at the end of its range
    is_behind = other.log_evidence < best.log_evidence
    return leads and (is_behind or has_evidence(best, other, criteria))


def refine_fit(prepared: PreparedData, fit: Fit) -> RefinedFit:
    """Correct the data at a fit, and try other values of its causes' parameters."""
    log.info("refining: %s", " + ".join(fit.hypothesis.cause_names))
    refined = correct_discretisation_once(prepared, fit)
    data = refined.prepared.data
    fit = refined.fit
    starts = alternative_parameter_starts(data, fit)
    if not len(starts):
        return refined
    other = fit_hypothesis(data, fit.hypothesis, starts, fit.scale_indices)
    if other.log_evidence > fit.log_evidence:
        return correct_discretisation_once(refined.prepared, other)
    return refined


def with_fit(state: SelectionState, fit: Fit) -> SelectionState:
    """Replace the fit of a state by another one, refined."""
    refined = refine_fit(state.prepared, fit)
    return replace(state, prepared=refined.prepared, fit=refined.fit)


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
        trials = len(prepared.discretisation_uncertainty_m)
        is_better = refined.fit.log_evidence > fit.log_evidence
        if is_better and is_resolved(refined.prepared, prepared, criteria, trials):
            prepared = refined.prepared
            fit = refined.fit
    return replace(state, prepared=prepared, fit=fit, steps=steps)


def _refit_step(
    data: TrialData, step: SelectionStep, criteria: Criteria
) -> SelectionStep:
    """Move a step to data with other points: refined fits are refitted."""
    parent = refit(data, step.parent, step.parent.hypothesis)
    refined = [refit(data, fit, fit.hypothesis) for fit in step.refined]
    was_refined = {id(fit) for fit in step.refined}  # fits hold arrays: no equality
    others = []
    for fit in step.fits:
        if id(fit) not in was_refined:
            others.append(evaluate_fit(data, fit.hypothesis, fit.chi))
    fits = rank_rivals(parent, [*refined, *others], criteria)
    unresolved = [refit(data, fit, fit.hypothesis) for fit in step.unresolved]
    # All are now on the same data
    return replace(
        step,
        data=data,
        parent=parent,
        fits=fits,
        refined=refined,
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
    alone = "it acts in one trial, which no other confirms, and misfit remains"
    return alone if acts_alone else "the trials do not agree on it"


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


def _fit_more_proposals(
    prepared: PreparedData,
    step: SelectionStep,
    proposals: Sequence[Proposal],
    criteria: Criteria,
) -> SelectionStep:
    """Fit more of a step's proposals, promising ones with their own numerical error."""
    data = prepared.data
    parent = step.parent
    sample, sampled_parent = _sample_trials(data, parent)

    def fit_proposal(number: int) -> Fit:
        proposal = proposals[number]
        name = proposal.effect.name
        log.info("%d of %d: %s", number + 1, len(proposals), name)
        hypothesis = proposal.hypothesis
        fit = _fit_roughly(sample, hypothesis, proposal.starts, sampled_parent)
        if sample is not data:
            fit = _fit_roughly(data, hypothesis, fit.chi[None], parent)
        gain = fit.log_evidence - parent.log_evidence
        log.info("%s: log evidence %+.1f, proposed %.1f", name, gain, proposal.gain)
        return fit

    fits = []
    fitted = map_in_workers(fit_proposal, range(len(proposals)))
    for fit, proposal in zip(fitted, proposals, strict=True):
        # A worker returns a copy of the hypothesis
        fits.append(replace(fit, hypothesis=proposal.hypothesis))

    # Those that may be refined, with numerical error of their own
    least_evidence = _least_evidence([*step.fits, *fits], parent, criteria)
    leading = [k for k, fit in enumerate(fits) if fit.log_evidence > least_evidence]

    def correct_roughly(number: int) -> Fit:
        fit = fits[number]
        data = correct_data_on_one_finer_mesh(prepared, fit)
        corrected = _fit_roughly(data, fit.hypothesis, fit.chi[None], fit)
        gain = corrected.log_evidence - parent.log_evidence
        name = fit.hypothesis.cause_names[-1]
        log.info("%s: log evidence %+.1f on a finer mesh", name, gain)
        return corrected

    for k, corrected in zip(
        leading, map_in_workers(correct_roughly, leading), strict=True
    ):
        # One finer mesh shows the error roughly: what may be evident is refined
        if corrected.log_evidence > fits[k].log_evidence:
            fits[k] = replace(corrected, hypothesis=fits[k].hypothesis)
    return replace(step, fits=rank_rivals(parent, [*step.fits, *fits], criteria))


def _fit_roughly(
    data: TrialData, hypothesis: Hypothesis, starts: np.ndarray, before: Fit
) -> Fit:
    """Fit a proposal, to a precision that is enough to rank it."""
    scale_indices = before.scale_indices
    min_gain = NEGLIGIBLE_LOG_EVIDENCE
    return fit_hypothesis(data, hypothesis, starts, scale_indices, min_gain)


def _least_evidence(fits: Sequence[Fit], parent: Fit, criteria: Criteria) -> float:
    """Compute the evidence of what explains enough to be a rival of the best fit."""
    best = max((fit.log_evidence for fit in fits), default=parent.log_evidence)
    gain = max(best - parent.log_evidence, 0.0)
    return parent.log_evidence + criteria.min_explained_fraction * gain


def rank_rivals(parent: Fit, fits: Sequence[Fit], criteria: Criteria) -> list[Fit]:
    """Sort fits by evidence, those after that are only ahead at the end of a range.

    A cause at the end of its range most likely stands for another one. Rivals that are
    inside theirs go before it if they explain at least `min_explained_fraction` of what
    the most evident fit does.
    """
    ranked = by_evidence(fits)
    if not ranked:
        return []
    least_evidence = _least_evidence(ranked, parent, criteria)
    inside = []
    others = []
    for fit in ranked:
        cause = fit.hypothesis.causes[-1]
        explains_much = fit.log_evidence >= least_evidence
        if (
            explains_much
            and has_evidence(parent, fit, criteria)
            and is_inside_range(fit, cause)
        ):
            inside.append(fit)
        else:
            others.append(fit)
    return [*inside, *others]


def by_evidence(fits: Sequence[Fit]) -> list[Fit]:
    """Sort fits, the most evident first."""
    return sorted(fits, key=lambda fit: -fit.log_evidence)
