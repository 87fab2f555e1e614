"""Comparison of all candidates for one more cause.

The most promising candidates are fitted roughly, first to a sample of the trials if
there are many. Those that explain about as much as the best are its rivals
(`rival_comparison`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence.measures import (
    fit_in_workers,
    mean_explained_fraction,
    refit,
    sample_by_misfit,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.rules import (
    NEGLIGIBLE_LOG_EVIDENCE,
    STRONG_LOG_EVIDENCE,
    Criteria,
    has_evidence,
)
from stringcast.stages.diagnose.search.proposals import (
    Proposal,
    propose_causes,
)
from stringcast.stages.diagnose.search.rival_comparison import compare_rivals
from stringcast.stages.diagnose.search.selection_step import (
    SelectionStep,
    least_evidence_of_rivals,
    precision_to_rank,
    rank_rivals,
)
from stringcast.stages.diagnose.trials.discretisation import (
    correct_data_on_one_finer_mesh,
)
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, is_position_dependent

log = logging.getLogger(__name__)

INITIAL_PROPOSALS = 6  # others are fitted only if these explain too little
MAX_SAMPLED_TRIALS = 8  # candidates are fitted first to these


def compare_candidates(
    prepared: PreparedData,
    parent: Fit,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    incumbent: Fit | None = None,
) -> SelectionStep:
    """Fit each effect in addition to a parent, and decide whether the best is accepted.

    Parameters
    ----------
    prepared : PreparedData
        Trials corrected at the parent, or with an accepted cause.
    parent : Fit
        The fit without the cause to be chosen.
    effects : sequence of type of Effect
        Candidates.
    criteria : Criteria
        Thresholds of the rules.
    seed : int
        Seed of the proposals.
    incumbent : Fit, optional
        The fit with an accepted cause, with which the candidates compete.
    """
    # The data changed since the parent was fitted; else candidates would gain by that
    parent = refit(prepared.data, parent, parent.hypothesis, NEGLIGIBLE_LOG_EVIDENCE)
    causes = parent.hypothesis.causes
    candidates = [effect for effect in effects if effect not in causes]
    sample = _sample_trials(prepared.data, parent)
    proposals = propose_causes(*sample, candidates, seed)
    step = SelectionStep(prepared.data, parent, proposals, (), incumbent=incumbent)
    remaining = proposals
    if incumbent is not None:
        step = replace(step, fits=(incumbent,))
        causes = incumbent.hypothesis.causes
        remaining = [p for p in proposals if p.effect not in causes]

    # At most two rounds: the most promising ones, then all others if these explain
    # too little. Each begins again if a better parent is found
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
                prepared, better, effects, criteria, seed, incumbent
            )
        decided = compare_rivals(prepared, step, decided, criteria)
        if decided.accepted:
            # A contact that is present would have been among the most promising
            remaining = [p for p in remaining if not is_position_dependent(p.effect)]
        if not remaining or _explains_enough(prepared.data, decided, criteria):
            return decided
        chosen = remaining


def _explains_enough(
    data: TrialData, decided: SelectionStep, criteria: Criteria
) -> bool:
    """Return whether no further candidates need to be fitted.

    If the best explains little, it may be a stand-in, and the real cause may be a less
    promising candidate. All were fitted when an incumbent was accepted.
    """
    tolerance_m = criteria.tip_tolerance_m
    before_m = unexplained_tip_rms(data, decided.parent)
    if before_m.max() < tolerance_m:
        return True
    if decided.best is None or not decided.accepted:
        return False
    if decided.incumbent is not None:
        return True
    after_m = unexplained_tip_rms(data, decided.best)
    explained = mean_explained_fraction(before_m, after_m, tolerance_m)
    return after_m.max() < tolerance_m or explained > criteria.min_explained_fraction


def _sample_trials(data: TrialData, parent: Fit) -> tuple[TrialData, Fit]:
    """Sample the trials to which candidates are first fitted, if that halves them."""
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
    """Find proposals that to first order explain much of what the best fit explains."""
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
    """Fit more of a step's proposals, leading ones with their own numerical error.

    sampled: the trials that are fitted first (`_sample_trials`).
    """
    parent = step.parent
    min_gain = precision_to_rank(_best_gain(step))
    fits = _fit_proposals(prepared.data, parent, proposals, sampled, min_gain)
    least_evidence = least_evidence_of_rivals([*step.fits, *fits], parent, criteria)
    fits = _correct_leading_fits(prepared, parent, fits, least_evidence, min_gain)
    return replace(step, fits=rank_rivals(parent, [*step.fits, *fits], criteria))


def _fit_proposals(
    data: TrialData,
    parent: Fit,
    proposals: Sequence[Proposal],
    sampled: tuple[TrialData, Fit],
    min_gain: float,
) -> list[Fit]:
    """Fit proposals from their starts, first to sampled trials.

    A fit that explains less than its parent starts again there.
    """
    sample, sampled_parent = sampled

    def fit_proposal(number: int) -> Fit:
        proposal = proposals[number]
        name = proposal.effect.name
        log.info("%d of %d: %s", number + 1, len(proposals), name)
        hypothesis = proposal.hypothesis
        grid_points = sampled_parent.grid_points
        fit = fit_hypothesis(sample, hypothesis, proposal.starts, grid_points, min_gain)
        grid_points = parent.grid_points
        if sample is not data:
            start = fit.chi[None]
            fit = fit_hypothesis(data, hypothesis, start, grid_points, min_gain)
        if _is_worse_than_contained(fit, parent):
            absent = hypothesis.exponents_from(parent.exponents)[None]
            fit = fit_hypothesis(data, hypothesis, absent, grid_points, min_gain)
        gain = fit.log_evidence - parent.log_evidence
        log.info("%s: log evidence %+.1f, proposed %.1f", name, gain, proposal.gain)
        return fit

    return fit_in_workers(fit_proposal, [p.hypothesis for p in proposals])


def _correct_leading_fits(
    prepared: PreparedData,
    parent: Fit,
    fits: Sequence[Fit],
    least_evidence: float,
    min_gain: float,
) -> list[Fit]:
    """Refit those that may lead with their own numerical error; return all.

    The error from one finer mesh is rough, so the larger evidence is kept.

    least_evidence: log evidence that a leading fit exceeds.
    """
    leading = [k for k, fit in enumerate(fits) if fit.log_evidence > least_evidence]

    def correct_roughly(number: int) -> Fit:
        fit = fits[leading[number]]
        data = correct_data_on_one_finer_mesh(prepared, fit)
        corrected = refit(data, fit, fit.hypothesis, min_gain)
        gain = corrected.log_evidence - parent.log_evidence
        name = fit.hypothesis.cause_names[-1]
        log.info("%s: log evidence %+.1f on a finer mesh", name, gain)
        return corrected

    corrections = fit_in_workers(correct_roughly, [fits[k].hypothesis for k in leading])
    better = list(fits)
    for k, corrected in zip(leading, corrections, strict=True):
        if corrected.log_evidence > fits[k].log_evidence:
            better[k] = corrected
    return better


def _is_worse_than_contained(fit: Fit, parent: Fit) -> bool:
    """Return whether a fit with a further cause is worse than its parent.

    The model contains the parent, so the proposed start must have been bad.
    """
    before = parent.log_likelihood_by_trial.sum()
    after = fit.log_likelihood_by_trial.sum()
    return bool(after < before - NEGLIGIBLE_LOG_EVIDENCE)


def _best_gain(step: SelectionStep) -> float:
    """Return the log evidence that the best candidate gains or is predicted to gain."""
    predicted = max((proposal.gain for proposal in step.proposals[:1]), default=0.0)
    return max(step.best_gain, predicted)


def _find_better_parent(
    prepared: PreparedData, step: SelectionStep, criteria: Criteria
) -> Fit | None:
    """Find a fit without a further cause that gains most of what the best gains.

    It starts from the optimum of the best candidate. If the parent is in a bad local
    minimum, any cause seems to gain.
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
        parent.grid_points,
        NEGLIGIBLE_LOG_EVIDENCE,
    )
    gain = other.log_evidence - parent.log_evidence
    log.info("without a further cause: log evidence %+.1f", gain)
    is_better = gain > criteria.min_explained_fraction * step.best_gain
    return other if is_better else None
