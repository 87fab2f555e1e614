"""Comparison of rivals: candidates that explain about as much as the best of them.

They are fitted to common data, each with its own numerical error. Then the best is
accepted or not.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence.measures import unexplained_tip_rms
from stringcast.stages.diagnose.rules import (
    MIN_RESOLVED_TRIALS,
    NEGLIGIBLE_LOG_EVIDENCE,
    UNRESOLVED_FRACTION,
    Criteria,
    has_evidence,
    is_resolved,
    is_supported,
)
from stringcast.stages.diagnose.search.selection_step import (
    SelectionStep,
    least_evidence_of_rivals,
    precision_to_rank,
    rank_rivals,
)
from stringcast.stages.diagnose.trials.common_data import fit_to_common_data
from stringcast.stages.diagnose.trials.discretisation import (
    discretisation_uncertainty_of,
)
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.inference.laplace import Fit

log = logging.getLogger(__name__)

MAX_RIVALS = 3  # compared at first
CLOSE_PRECISIONS = 5  # possible change of a roughly fitted rival, over its precision


def compare_rivals(
    prepared: PreparedData,
    step: SelectionStep,
    before: SelectionStep,
    criteria: Criteria,
) -> SelectionStep:
    """Fit the best and its rivals to common data, and decide whether it is accepted.

    Parameters
    ----------
    prepared : PreparedData
        Trials corrected at the parent.
    step : SelectionStep
        All fits so far, ranked.
    before : SelectionStep
        The decision among fewer candidates; its compared fits are reused.
    criteria : Criteria
        Thresholds of the rules.

    Returns
    -------
    SelectionStep
        The step with its parent and leading fits on common data, ranked again.
    """
    if step.best is None or not has_evidence(step.parent, step.best, criteria):
        return step

    # The parent and the rivals. Common data usually lower the evidence: a fit that is
    # not compared must not lead
    least_evidence = least_evidence_of_rivals(step.fits, step.parent, criteria)
    rivals = [f for f in step.fits[:MAX_RIVALS] if f.log_evidence > least_evidence]
    min_gain = precision_to_rank(step.best_gain)
    parent, *compared = _fit_new_rivals(prepared, step, rivals, before, min_gain)
    compared_causes = [fit.hypothesis.causes[-1] for fit in compared]
    others = [f for f in step.fits if f.hypothesis.causes[-1] not in compared_causes]
    others = _shift_evidence(others, parent.log_evidence - step.parent.log_evidence)

    # Another fit is compared, too, while it would lead
    fitted = list[Fit]()
    while True:
        fitted += _refit_rivals_behind_parent(prepared, parent, compared)
        resolved, unresolved = _split_by_resolution(
            prepared, step, parent, fitted, criteria
        )
        resolved = rank_rivals(parent, resolved, criteria)
        if not _is_overtaken(parent, resolved, others, criteria):
            break
        known = [parent, *resolved, *unresolved]
        compared = fit_to_common_data(prepared, others[:1], known, min_gain)
        others = others[1:]

    # The ranking of close rivals, and the decision about the best
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
    """Fit the parent and rivals to common data, except those compared before."""
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
    """Refit rivals that are too close to the best to be ranked.

    Parameters
    ----------
    ranked, known : sequence of Fit
        Rivals, and all fits to common data.
    min_gain : float
        Precision in log evidence to which the rivals were fitted.
    """
    best = max((fit.log_evidence for fit in ranked), default=0.0)
    least_evidence = best - CLOSE_PRECISIONS * min_gain
    close = [k for k, fit in enumerate(ranked) if fit.log_evidence > least_evidence]
    if len(close) < 2:
        return list(ranked)
    unsettled = []
    for k in close:
        if ranked[k].log_evidence_error > NEGLIGIBLE_LOG_EVIDENCE:
            unsettled.append(k)
    return _refit_selected(prepared, ranked, unsettled, known)


def _split_by_resolution(
    prepared: PreparedData,
    step: SelectionStep,
    parent: Fit,
    rivals: Sequence[Fit],
    criteria: Criteria,
) -> tuple[list[Fit], list[Fit]]:
    """Split rivals by whether simulation with them resolves enough trials to lead.

    The numerical uncertainty of the others may explain their gain. A rival of an
    accepted cause must resolve all trials; the accepted cause itself was shown to
    resolve enough. One that resolves fewer than half cannot lead another that resolves
    these and explains half as much, because most trials would be left out.
    """
    before_m = prepared.discretisation_uncertainty_m
    trials = len(before_m)
    needed = trials
    allowance_m = np.zeros(trials)
    if step.incumbent is None:
        needed = min(MIN_RESOLVED_TRIALS, trials)
        # A fraction of the mean squares, hence the root
        misfit_m = unexplained_tip_rms(prepared.data, step.parent)
        allowance_m = np.sqrt(UNRESOLVED_FRACTION) * misfit_m
    half = (trials + 1) // 2
    accepted = step.incumbent.hypothesis.causes[-1:] if step.incumbent else ()

    resolved = []
    resolved_in_few = []
    unresolved = []
    for fit in rivals:
        if fit.hypothesis.causes[-1] in accepted:
            resolved.append(fit)
            continue
        uncertainty_m = discretisation_uncertainty_of(prepared, fit)
        if not is_resolved(uncertainty_m, before_m, criteria, needed, allowance_m):
            unresolved.append(fit)
        elif is_resolved(uncertainty_m, before_m, criteria, half):
            resolved.append(fit)
        else:
            resolved_in_few.append(fit)
    leaders = [*resolved, *resolved_in_few]
    least_evidence = least_evidence_of_rivals(leaders, parent, criteria)
    if any(fit.log_evidence >= least_evidence for fit in resolved):
        return resolved, [*unresolved, *resolved_in_few]
    return leaders, unresolved


def _unresolved_ahead(resolved: Sequence[Fit], unresolved: Sequence[Fit]) -> list[Fit]:
    """Select unresolved fits with as much evidence as the best resolved one."""
    ahead = []
    for fit in unresolved:
        if resolved and fit.log_evidence >= resolved[0].log_evidence:
            name = fit.hypothesis.cause_names[-1]
            log.info("%s cannot be simulated well enough to be distinguished", name)
            ahead.append(fit)
    return ahead


def _refit_rivals_behind_parent(
    prepared: PreparedData, parent: Fit, compared: Sequence[Fit]
) -> list[Fit]:
    """Refit rivals from their parent that explain less than it, which they contain."""

    def log_likelihood(fit: Fit) -> float:
        return float(fit.log_likelihood_by_trial.sum())

    least = log_likelihood(parent) - NEGLIGIBLE_LOG_EVIDENCE
    behind = [k for k, fit in enumerate(compared) if log_likelihood(fit) < least]
    return _refit_selected(prepared, compared, behind, [parent])


def _refit_selected(
    prepared: PreparedData,
    fits: Sequence[Fit],
    numbers: Sequence[int],
    known: Sequence[Fit],
) -> list[Fit]:
    """Refit those with some indices to common data; return all.

    known: fits to common data, the best of which is a further start.
    """
    updated = list(fits)
    refitted = fit_to_common_data(prepared, [fits[k] for k in numbers], known)
    for k, fit in zip(numbers, refitted, strict=True):
        updated[k] = fit
    return updated


def _shift_evidence(fits: Sequence[Fit], shift: float) -> list[Fit]:
    """Shift the log evidence of fits as that of their parent changed."""
    return [replace(fit, log_evidence=fit.log_evidence + shift) for fit in fits]


def _is_overtaken(
    parent: Fit,
    compared: Sequence[Fit],
    others: Sequence[Fit],
    criteria: Criteria,
) -> bool:
    """Return whether the first of the other fits clearly leads those on common data."""
    if not others:
        return False
    other = others[0]
    if not compared:
        return has_evidence(parent, other, criteria)
    best = compared[0]
    leads = rank_rivals(parent, [best, other], criteria)[0] is other
    # If it leads with less evidence, the best is at the end of its range
    is_behind = other.log_evidence < best.log_evidence
    return leads and (is_behind or has_evidence(best, other, criteria))
