"""A comparison of candidates for one more cause, and their ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stringcast.stages.diagnose.rules import (
    NEGLIGIBLE_LOG_EVIDENCE,
    Criteria,
    has_evidence,
    is_inside_range,
)
from stringcast.stages.diagnose.search.proposals import Proposal
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.trial_data import TrialData

RANKING_PRECISION = 0.01  # of the best candidate's gain: precision of fits


@dataclass(frozen=True)
class SelectionStep:
    """Comparison of all candidates for one more cause.

    Attributes
    ----------
    data : TrialData
        Data of the parent and the leading fits, before their own numerical errors.
    parent : Fit
        The fit without the cause to be chosen.
    proposals : sequence of Proposal
        Proposals of all candidates, the most promising first.
    fits : sequence of Fit
        All fits, ranked by `rank_rivals`.
    compared : sequence of Fit
        The leading ones; they and the parent are fitted to common data.
    accepted : bool
        Whether the best is accepted.
    unresolved : sequence of Fit
        Fits with as much evidence as the best on common data, with which too few
        trials can be simulated. They cannot be distinguished from it.
    incumbent : Fit, optional
        The fit with an accepted cause, with which the candidates compete.
    """

    data: TrialData
    parent: Fit
    proposals: Sequence[Proposal]
    fits: Sequence[Fit]
    compared: Sequence[Fit] = ()
    accepted: bool = False
    unresolved: Sequence[Fit] = ()
    incumbent: Fit | None = None

    @property
    def best(self) -> Fit | None:
        """The leading fit, or None."""
        return self.fits[0] if self.fits else None

    @property
    def best_gain(self) -> float:
        """The log evidence that the leading fit gains over the parent; 0 for none."""
        if self.best is None:
            return 0.0
        return self.best.log_evidence - self.parent.log_evidence


def rank_rivals(parent: Fit, fits: Sequence[Fit], criteria: Criteria) -> list[Fit]:
    """Sort fits by evidence, but rank rivals inside their ranges first.

    A cause at the end of its range probably stands for another one. Rivals inside
    their ranges rank above it if they gain at least `min_explained_fraction` of what
    the most evident fit gains.
    """
    ranked = by_evidence(fits)
    if not ranked:
        return []
    least_evidence = least_evidence_of_rivals(ranked, parent, criteria)
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


def least_evidence_of_rivals(
    fits: Sequence[Fit], parent: Fit, criteria: Criteria
) -> float:
    """Compute the least log evidence of a rival of the best fit."""
    best = max((fit.log_evidence for fit in fits), default=parent.log_evidence)
    gain = max(best - parent.log_evidence, 0.0)
    return parent.log_evidence + criteria.min_explained_fraction * gain


def by_evidence(fits: Sequence[Fit]) -> list[Fit]:
    """Sort fits, the most evident first."""
    return sorted(fits, key=lambda fit: -fit.log_evidence)


def precision_to_rank(best_gain: float) -> float:
    """Compute the precision in log evidence to which candidates are fitted.

    best_gain: gain in log evidence of the best candidate.
    """
    return max(RANKING_PRECISION * best_gain, NEGLIGIBLE_LOG_EVIDENCE)
