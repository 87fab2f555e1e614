"""A comparison of candidates for one more cause, and how they are ranked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stringcast.stages.diagnose.proposals import Proposal
from stringcast.stages.diagnose.rules import (
    NEGLIGIBLE_LOG_EVIDENCE,
    Criteria,
    has_evidence,
    is_inside_range,
)
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.trial_data import TrialData

RANKING_PRECISION = 0.01  # of what the best candidate gains, to which others are fitted


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
    contested : Fit, optional
        The fit with a cause that was accepted, whose place is contested.
    """

    data: TrialData
    parent: Fit
    proposals: Sequence[Proposal]
    fits: Sequence[Fit]
    compared: Sequence[Fit] = ()
    accepted: bool = False
    unresolved: Sequence[Fit] = ()
    contested: Fit | None = None

    @property
    def best(self) -> Fit | None:
        """The fit that leads."""
        return self.fits[0] if self.fits else None

    @property
    def best_gain(self) -> float:
        """The log evidence that the leading fit gains over the parent; 0 for none."""
        if self.best is None:
            return 0.0
        return self.best.log_evidence - self.parent.log_evidence


def rank_rivals(parent: Fit, fits: Sequence[Fit], criteria: Criteria) -> list[Fit]:
    """Sort fits by evidence, those after that are only ahead at the end of a range.

    A cause at the end of its range most likely stands for another one. Rivals that are
    inside theirs go before it if they explain at least `min_explained_fraction` of what
    the most evident fit does.
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
    """Compute the evidence of what explains enough to be a rival of the best fit."""
    best = max((fit.log_evidence for fit in fits), default=parent.log_evidence)
    gain = max(best - parent.log_evidence, 0.0)
    return parent.log_evidence + criteria.min_explained_fraction * gain


def by_evidence(fits: Sequence[Fit]) -> list[Fit]:
    """Sort fits, the most evident first."""
    return sorted(fits, key=lambda fit: -fit.log_evidence)


def precision_to_rank(best_gain: float) -> float:
    """Compute the log evidence to which candidates are fitted, to be ranked.

    best_gain: of the log evidence, by the best of them.
    """
    return max(RANKING_PRECISION * best_gain, NEGLIGIBLE_LOG_EVIDENCE)
