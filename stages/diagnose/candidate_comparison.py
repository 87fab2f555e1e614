"""Comparison of all candidates for one more cause.

The most promising candidates are fitted roughly, in a sample of the trials if there are
many. Those that explain about as much as the best, its rivals, are fitted to common
data, each with its own numerical error. The best is then accepted or not.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stringcast.stages.diagnose.common_data import fit_to_common_data
from stringcast.stages.diagnose.discretisation import (
    correct_data_on_one_finer_mesh,
    correct_discretisation_once,
    discretisation_uncertainty_of,
)
from stringcast.stages.diagnose.measures import (
    mean_explained_fraction,
    sample_by_misfit,
    unexplained_tip_rms,
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
    is_inside_range,
    is_resolved,
    is_supported,
)
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, is_position_dependent
from stringcast.stages.workers import map_in_workers

log = logging.getLogger(__name__)

INITIAL_PROPOSALS = 6  # the others are fitted if these explain little of what is left
MAX_RIVALS = 3  # that are compared at first
MAX_SAMPLED_TRIALS = 8  # candidates are tried in these before all
RANKING_PRECISION = 0.01  # of what the best candidate gains, to which others are fitted
CLOSE_PRECISIONS = 5  # by which a fit that ended so early may still change
UNRESOLVED_FRACTION = 0.1  # of a trial's mean square misfit that may stay unresolved


class UncertainFit(NamedTuple):
    """A fit, and the uncertainty of its discretisation error at the tips [m], (K,)."""

    fit: Fit
    uncertainty_m: np.ndarray


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
    compared : sequence of Fit
        Those of them near the leading one; they and the parent are on common data.
    accepted : bool
        Whether the best is accepted.
    unresolved : sequence of Fit
        Those that have as much evidence as the best on common data, but by which too
        few trials can be simulated. They cannot be distinguished from it.
    """

    data: TrialData
    parent: Fit
    proposals: Sequence[Proposal]
    fits: Sequence[Fit]
    compared: Sequence[Fit] = ()
    accepted: bool = False
    unresolved: Sequence[Fit] = ()

    @property
    def best(self) -> Fit | None:
        """The fit that leads."""
        return self.fits[0] if self.fits else None


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
        The fit with a cause that was accepted, whose place is contested.
    """
    parent = _fit_to_corrected_data(prepared, parent)
    causes = parent.hypothesis.causes
    candidates = [effect for effect in effects if effect not in causes]
    sample = _sample_trials(prepared.data, parent)
    proposals = propose_causes(*sample, candidates, seed)
    step = SelectionStep(prepared.data, parent, proposals, fits=())
    remaining = proposals
    if contested is not None:
        step = replace(step, fits=(contested,))
        causes = contested.hypothesis.causes
        remaining = [p for p in proposals if p.effect not in causes]

    # The most promising ones; then all others, if these explain too little
    chosen = [p for p in remaining[:INITIAL_PROPOSALS] if p.gain > STRONG_LOG_EVIDENCE]
    decided = step
    while True:
        step = _fit_more_proposals(prepared, step, chosen, criteria, sample)
        remaining = [p for p in remaining if p not in chosen]
        lookalikes = _lookalikes_of_best(step, remaining, criteria)
        step = _fit_more_proposals(prepared, step, lookalikes, criteria, sample)
        remaining = [p for p in remaining if p not in lookalikes]
        better = _find_better_parent(prepared, step, criteria)
        if better is not None:
            return compare_candidates(
                prepared, better, effects, criteria, seed, contested
            )
        is_contested = contested is not None
        decided = _compare_rivals(prepared, step, decided, criteria, is_contested)
        if decided.accepted:
            # A contact that is there promises much: it explains the departure
            remaining = [p for p in remaining if not is_position_dependent(p.effect)]
        if not remaining or _explains_enough(
            prepared.data, decided, criteria, is_contested
        ):
            return decided
        chosen = remaining


def _fit_to_corrected_data(prepared: PreparedData, fit: Fit) -> Fit:
    """Fit a hypothesis again to data that were corrected where its fit had ended.

    Otherwise each candidate would gain what that gains.
    """
    scale_indices = fit.scale_indices
    min_gain = NEGLIGIBLE_LOG_EVIDENCE
    start = fit.chi[None]
    return fit_hypothesis(prepared.data, fit.hypothesis, start, scale_indices, min_gain)


def _explains_enough(
    data: TrialData, decided: SelectionStep, criteria: Criteria, is_contested: bool
) -> bool:
    """Whether no other candidates need to be fitted than those compared in a step.

    A stand-in explains little of what is left, and the cause may have promised less. In
    the place of a cause that was accepted, others were fitted before.
    """
    tolerance_m = criteria.tip_tolerance_m
    before_m = unexplained_tip_rms(data, decided.parent)
    if before_m.max() < tolerance_m:
        return True
    if decided.best is None or not decided.accepted:
        return False
    if is_contested:
        return True
    after_m = unexplained_tip_rms(data, decided.best)
    explained = mean_explained_fraction(before_m, after_m, tolerance_m)
    return after_m.max() < tolerance_m or explained > criteria.min_explained_fraction


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


def _fit_more_proposals(
    prepared: PreparedData,
    step: SelectionStep,
    proposals: Sequence[Proposal],
    criteria: Criteria,
    sampled: tuple[TrialData, Fit],
) -> SelectionStep:
    """Fit more of a step's proposals, promising ones with their own numerical error.

    sampled: the trials that are fitted first, as of `_sample_trials`.
    """
    data = prepared.data
    parent = step.parent
    sample, sampled_parent = sampled
    min_gain = precision_to_rank(_best_gain(step))

    def fit_proposal(number: int) -> Fit:
        proposal = proposals[number]
        name = proposal.effect.name
        log.info("%d of %d: %s", number + 1, len(proposals), name)
        hypothesis = proposal.hypothesis
        scale_indices = sampled_parent.scale_indices
        fit = fit_hypothesis(
            sample, hypothesis, proposal.starts, scale_indices, min_gain
        )
        if sample is not data:
            scale_indices = parent.scale_indices
            start = fit.chi[None]
            fit = fit_hypothesis(data, hypothesis, start, scale_indices, min_gain)
        gain = fit.log_evidence - parent.log_evidence
        log.info("%s: log evidence %+.1f, proposed %.1f", name, gain, proposal.gain)
        return fit

    fits = []
    fitted = map_in_workers(fit_proposal, range(len(proposals)))
    for fit, proposal in zip(fitted, proposals, strict=True):
        # A worker returns a copy of the hypothesis
        fits.append(replace(fit, hypothesis=proposal.hypothesis))

    # Those that may lead, with numerical error of their own
    least_evidence = _least_evidence([*step.fits, *fits], parent, criteria)
    leading = [k for k, fit in enumerate(fits) if fit.log_evidence > least_evidence]

    def correct_roughly(number: int) -> Fit:
        fit = fits[number]
        data = correct_data_on_one_finer_mesh(prepared, fit)
        start = fit.chi[None]
        corrected = fit_hypothesis(
            data, fit.hypothesis, start, fit.scale_indices, min_gain
        )
        gain = corrected.log_evidence - parent.log_evidence
        name = fit.hypothesis.cause_names[-1]
        log.info("%s: log evidence %+.1f on a finer mesh", name, gain)
        return corrected

    for k, corrected in zip(
        leading, map_in_workers(correct_roughly, leading), strict=True
    ):
        # One finer mesh shows the error roughly: what may be evident is compared
        if corrected.log_evidence > fits[k].log_evidence:
            fits[k] = replace(corrected, hypothesis=fits[k].hypothesis)
    return replace(step, fits=rank_rivals(parent, [*step.fits, *fits], criteria))


def _best_gain(step: SelectionStep) -> float:
    """Return the log evidence that the best candidate gains, or promises to gain."""
    gains = [fit.log_evidence - step.parent.log_evidence for fit in step.fits[:1]]
    promised = [proposal.gain for proposal in step.proposals[:1]]
    return max([*gains, *promised], default=0.0)


def _find_better_parent(
    prepared: PreparedData, step: SelectionStep, criteria: Criteria
) -> Fit | None:
    """Find a fit without a further cause that gains most of what the best gains.

    Such a fit is sought from where the best candidate has come to. While the parent is
    in a worse minimum, any cause seems to gain.
    """
    parent = step.parent
    best = step.best
    if best is None or not has_evidence(parent, best, criteria):
        return None
    hypothesis = parent.hypothesis
    shared = hypothesis.exponents_from(best.exponents)
    starts = np.stack([parent.chi, shared])
    other = fit_hypothesis(
        prepared.data,
        hypothesis,
        starts,
        parent.scale_indices,
        NEGLIGIBLE_LOG_EVIDENCE,
    )
    gain = other.log_evidence - parent.log_evidence
    log.info("without a further cause: log evidence %+.1f", gain)
    possible = best.log_evidence - parent.log_evidence
    return other if gain > criteria.min_explained_fraction * possible else None


def precision_to_rank(best_gain: float) -> float:
    """Compute the log evidence to which candidates are fitted, to be ranked.

    best_gain: of the log evidence, by the best of them.
    """
    return max(RANKING_PRECISION * best_gain, NEGLIGIBLE_LOG_EVIDENCE)


def _compare_rivals(
    prepared: PreparedData,
    step: SelectionStep,
    before: SelectionStep,
    criteria: Criteria,
    is_contested: bool,
) -> SelectionStep:
    """Fit the best and its rivals to common data, and decide whether it is accepted.

    before: the decision among fewer candidates; what was compared there stays.
    is_contested: whether the place of a cause that was accepted is contested.
    """
    if step.best is None or not has_evidence(step.parent, step.best, criteria):
        return step

    # Common data mostly lower the evidence: none may lead because it was not compared
    least_evidence = _least_evidence(step.fits, step.parent, criteria)
    rivals = [f for f in step.fits[:MAX_RIVALS] if f.log_evidence > least_evidence]
    min_gain = precision_to_rank(step.best.log_evidence - step.parent.log_evidence)
    parent, *compared = _fit_new_rivals(prepared, step, rivals, before, min_gain)
    causes = [fit.hypothesis.causes[-1] for fit in compared]
    waiting = [fit for fit in step.fits if fit.hypothesis.causes[-1] not in causes]
    uncertain = list[UncertainFit]()
    while True:
        for fit in _catch_up_with_parent(prepared, parent, compared):
            uncertainty_m = discretisation_uncertainty_of(prepared, fit)
            uncertain.append(UncertainFit(fit, uncertainty_m))
        resolved, unresolved = _split_by_resolution(
            prepared, step, parent, uncertain, criteria, is_contested
        )
        resolved = rank_rivals(parent, resolved, criteria)
        shift = parent.log_evidence - step.parent.log_evidence
        others = _shift_evidence(waiting, shift)
        if not _is_overtaken(parent, resolved, others, criteria):
            break
        known = [parent, *resolved, *unresolved]
        compared = fit_to_common_data(prepared, waiting[:1], known, min_gain)
        waiting = waiting[1:]

    known = [parent, *resolved, *unresolved]
    resolved = _fit_close_rivals_precisely(prepared, resolved, known, min_gain)
    resolved = rank_rivals(parent, resolved, criteria)
    for fit in [*resolved, *unresolved]:
        name = fit.hypothesis.cause_names[-1]
        gain = fit.log_evidence - parent.log_evidence
        log.info("on common data: %s, log evidence %+.1f", name, gain)
    every_fit = [*resolved, *others]
    is_accepted = bool(every_fit) and is_supported(
        prepared.data, parent, every_fit[0], criteria
    )
    return replace(
        step,
        parent=parent,
        fits=every_fit,
        compared=resolved,
        accepted=is_accepted,
        unresolved=_unresolved_ahead(resolved, unresolved),
    )


def _fit_new_rivals(
    prepared: PreparedData,
    step: SelectionStep,
    rivals: Sequence[Fit],
    before: SelectionStep,
    min_gain: float,
) -> list[Fit]:
    """Fit the parent and rivals to common data, but for what was compared before."""
    if not before.compared:
        new = [step.parent, *rivals]
        return fit_to_common_data(prepared, new, min_gain=min_gain)
    known = [before.parent, *before.compared]
    causes = [fit.hypothesis.causes[-1] for fit in before.compared]
    new = [fit for fit in rivals if fit.hypothesis.causes[-1] not in causes]
    return [*known, *fit_to_common_data(prepared, new, known, min_gain)]


def _fit_close_rivals_precisely(
    prepared: PreparedData,
    ranked: Sequence[Fit],
    known: Sequence[Fit],
    min_gain: float,
) -> list[Fit]:
    """Fit rivals again that are too close to the best to be told apart from it.

    Parameters
    ----------
    ranked, known : sequence of Fit
        Rivals, and all that was fitted to common data.
    min_gain : float
        Of the log evidence, to which the rivals were fitted.
    """
    fits = list(ranked)
    best = max((fit.log_evidence for fit in fits), default=0.0)
    close = []
    for k, fit in enumerate(fits):
        if fit.log_evidence > best - CLOSE_PRECISIONS * min_gain:
            close.append(k)
    if len(close) < 2:
        return fits
    unsettled = [
        k for k in close if fits[k].log_evidence_error > NEGLIGIBLE_LOG_EVIDENCE
    ]
    refitted = fit_to_common_data(prepared, [fits[k] for k in unsettled], known)
    for k, fit in zip(unsettled, refitted, strict=True):
        fits[k] = fit
    return fits


def _split_by_resolution(
    prepared: PreparedData,
    step: SelectionStep,
    parent: Fit,
    rivals: Sequence[UncertainFit],
    criteria: Criteria,
    is_contested: bool,
) -> tuple[list[Fit], list[Fit]]:
    """Split rivals by whether simulation with them resolves enough trials to lead.

    What is uncertain in the others may explain anything. In the place of a cause that
    was accepted a rival must resolve all trials. One that resolves fewer than half
    does not lead another that resolves these and explains half as much: most trials
    would be left out.
    """
    before_m = prepared.discretisation_uncertainty_m
    trials = len(before_m)
    needed = trials
    allowance_m = np.zeros(trials)
    if not is_contested:
        needed = min(MIN_RESOLVED_TRIALS, trials)
        # A fraction of mean squares, and the roots of both
        misfit_m = unexplained_tip_rms(prepared.data, step.parent)
        allowance_m = np.sqrt(UNRESOLVED_FRACTION) * misfit_m
    half = (trials + 1) // 2

    resolved = []
    rough = []
    unresolved = []
    for fit, uncertainty_m in rivals:
        if not is_resolved(uncertainty_m, before_m, criteria, needed, allowance_m):
            unresolved.append(fit)
        elif is_resolved(uncertainty_m, before_m, criteria, half):
            resolved.append(fit)
        else:
            rough.append(fit)
    least_evidence = _least_evidence([*resolved, *rough], parent, criteria)
    if any(fit.log_evidence >= least_evidence for fit in resolved):
        return resolved, [*unresolved, *rough]
    return [*resolved, *rough], unresolved


def _unresolved_ahead(resolved: Sequence[Fit], unresolved: Sequence[Fit]) -> list[Fit]:
    """Select unresolved fits with as much evidence as the best resolved one."""
    ahead = []
    for fit in unresolved:
        if resolved and fit.log_evidence >= resolved[0].log_evidence:
            name = fit.hypothesis.cause_names[-1]
            log.info("%s cannot be simulated well enough to be told apart", name)
            ahead.append(fit)
    return ahead


def _catch_up_with_parent(
    prepared: PreparedData, parent: Fit, compared: Sequence[Fit]
) -> list[Fit]:
    """Fit those again from their parent that explain less: they hold all it does."""

    def log_likelihood(fit: Fit) -> float:
        return float(fit.log_likelihood_by_trial.sum())

    least = log_likelihood(parent) - NEGLIGIBLE_LOG_EVIDENCE
    fits = list(compared)
    behind = [k for k, fit in enumerate(fits) if log_likelihood(fit) < least]
    refitted = fit_to_common_data(prepared, [fits[k] for k in behind], [parent])
    for k, fit in zip(behind, refitted, strict=True):
        fits[k] = fit
    return fits


def _shift_evidence(fits: Sequence[Fit], shift: float) -> list[Fit]:
    """Shift the log evidence of fits, as that of their parent on common data is."""
    return [replace(fit, log_evidence=fit.log_evidence + shift) for fit in fits]


def _is_overtaken(
    parent: Fit,
    compared: Sequence[Fit],
    others: Sequence[Fit],
    criteria: Criteria,
) -> bool:
    """Whether the first of the other fits clearly leads those on common data."""
    if not others:
        return False
    other = others[0]
    if not compared:
        return has_evidence(parent, other, criteria)
    best = compared[0]
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
