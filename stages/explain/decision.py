"""Compute probabilities of the compared causes, and decide the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stringcast.stages.common import MM_PER_M, describe_causes
from stringcast.stages.diagnose.evidence.probabilities import effect_probabilities
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Causes,
    Comparison,
    explains_half,
    log_prior_odds_of_further_causes,
    tip_rms_m,
)
from stringcast.stages.explain.noise_ratios import NoiseRatios

NAMED_PROBABILITY = 0.9  # from which causes are named
MIXED_PROBABILITY = 0.05  # from which the next plan uses draws of causes
TIME_IS_UP = "the processor time was used up before all likely causes were fitted"


@dataclass(frozen=True)
class Evidence:
    """The causes that a search compared, and the numbers that decide the verdict.

    Parameters
    ----------
    compared : mapping
        Comparisons by their causes.
    probabilities : mapping
        Probabilities of the same causes, the largest first; with the untried ones,
        their sum is 1.
    noise_ratios : NoiseRatios
        Ratios of the best causes if they explain half of the misfit, else of no cause.
    tolerance_m : float
        Tip misfit that is small [m].
    is_complete : bool
        Whether all likely causes were fitted.
    is_checked : bool
        Whether rivals were compared, or earlier trials showed the same causes.
    untried_probability : float
        Probability of causes that there was no time to compare.
    """

    compared: Mapping[Causes, Comparison]
    probabilities: Mapping[Causes, float]
    noise_ratios: NoiseRatios
    tolerance_m: float
    is_complete: bool
    is_checked: bool = True
    untried_probability: float = 0.0

    @property
    def best(self) -> Comparison:
        """The most probable causes that were fitted."""
        return most_probable_fit(self.compared, self.probabilities)

    @property
    def base(self) -> Comparison:
        """The fit of the original model."""
        return self.compared[NO_CAUSE]


def posterior_probabilities(
    compared: Mapping[Causes, Comparison],
    candidates: int,
    untried_probability: float = 0.0,
) -> dict[Causes, float]:
    """Compute the probability of all compared causes, the most probable first.

    Parameters
    ----------
    compared : mapping to Comparison
        Comparisons by their causes.
    candidates : int
        Number of effects that share the prior probability of one being active.
    untried_probability : float
        Probability of causes that there was no time to compare.
    """
    log_evidence = {}
    for causes, comparison in compared.items():
        prior_odds = log_prior_odds_of_further_causes(causes, candidates)
        log_evidence[causes] = np.array([comparison.log_evidence + prior_odds])
    probabilities = effect_probabilities(log_evidence, candidates)
    ranked = sorted(probabilities, key=lambda causes: -probabilities[causes])
    tried = 1 - untried_probability
    return {causes: tried * probabilities[causes] for causes in ranked}


def most_probable_fit(
    compared: Mapping[Causes, Comparison], probabilities: Mapping[Causes, float]
) -> Comparison:
    """Return the most probable causes that were fitted, or no cause."""
    fitted = [c for c in probabilities if compared[c].estimate is not None]
    return compared[max(fitted, key=lambda causes: probabilities[causes])]


def decide(evidence: Evidence) -> tuple[str, str]:
    """Decide the verdict, and state it in words."""
    if evidence.best.causes and explains_half(evidence.best, evidence.base):
        return _decide_about_causes(evidence)
    return _decide_without_causes(evidence)


def _decide_without_causes(evidence: Evidence) -> tuple[str, str]:
    """Decide whether the trials need a cause that was not found."""
    ratios = evidence.noise_ratios
    tip_m = tip_rms_m(evidence.base.estimate)
    if not evidence.is_complete:
        leading = next(iter(evidence.probabilities))
        finding = "No cause was found"
        if evidence.compared[leading].estimate is None:
            probability = evidence.probabilities[leading]
            name = describe_causes(leading)
            finding = f"The most probable cause is {name} ({probability:.2f})"
        return "undecided", f"{finding}; {TIME_IS_UP}."
    if tip_m > evidence.tolerance_m and not ratios.leave_only_mesh_error:
        misfit = f"the tip's misfit of {MM_PER_M * tip_m:.1f} mm"
        return "unknown", f"No single effect explains {misfit}."
    if not ratios.leave_only_noise:
        excess = "why the residual exceeds the noise"
        return "unknown", f"No single effect explains {excess}."
    return (
        "none",
        "No cause is needed: the model leaves only noise where the mesh resolves it.",
    )


def _decide_about_causes(evidence: Evidence) -> tuple[str, str]:
    """Decide whether to name the most probable causes, which explain half or more."""
    best = evidence.best
    ratios = evidence.noise_ratios
    tip_m = tip_rms_m(best.estimate)
    base_mm = MM_PER_M * tip_rms_m(evidence.base.estimate)
    name = describe_causes(best.causes)
    effect = (
        f"With {name} the tip is {MM_PER_M * tip_m:.1f} mm off instead of {base_mm:.1f}"
    )
    has_small_misfit = tip_m <= evidence.tolerance_m
    is_explained = has_small_misfit or ratios.leave_only_mesh_error
    if not evidence.is_complete and not is_explained:
        return "undecided", f"{effect}; {TIME_IS_UP}."

    probability = evidence.probabilities[best.causes]
    if probability < NAMED_PROBABILITY:
        others = []
        for causes, p in evidence.probabilities.items():
            if p >= MIXED_PROBABILITY:
                others.append(f"{describe_causes(causes)} ({p:.2f})")
        if evidence.untried_probability >= MIXED_PROBABILITY:
            untried = f"causes not compared ({evidence.untried_probability:.2f})"
            others.append(f"{untried}, because {TIME_IS_UP}")
        return "candidates", f"{effect}, but others may act: {', '.join(others)}."

    effect += f" (probability {probability:.2f})"
    if not is_explained:
        return "partial", f"{effect}; the rest is not explained."
    caveat = ""
    if not ratios.leave_only_noise:
        caveat = "the residual exceeds the noise: other causes may act"
    elif not ratios.explain_half:
        caveat = (
            "less than half of the misfit is explained where the error of the mesh is "
            "below the noise"
        )
    elif not evidence.is_checked:
        caveat = TIME_IS_UP
    if caveat:
        return "candidates", f"{effect}, but {caveat}."
    if not has_small_misfit:
        effect += "; the rest is the error of the mesh"
    return "cause", f"{effect}."
