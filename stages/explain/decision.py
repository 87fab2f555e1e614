"""Compute probabilities of the compared causes, and decide the verdict."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.common import MM_PER_M, describe_causes
from stringcast.stages.diagnose.probabilities import (
    PRIOR_NO_EFFECT,
    effect_probabilities,
)
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Comparison,
    explains_half,
    tip_rms_m,
)
from stringcast.stages.explain.noise_ratios import NoiseRatios

NAMED_PROBABILITY = 0.9  # from which causes are named
MIXED_PROBABILITY = 0.05  # from which the next plan uses draws of causes
TIME_IS_UP = "the processor time was used up before all likely causes were fitted"


def posterior_probabilities(
    compared: Mapping[tuple[str, ...], Comparison], candidates: int
) -> dict[tuple[str, ...], float]:
    """Compute the probability of all compared causes, the most probable first.

    A priori, effects are independent.
    """
    prior_odds = (1 - PRIOR_NO_EFFECT) / candidates / PRIOR_NO_EFFECT
    log_evidence = {}
    for causes, each in compared.items():
        # `effect_probabilities` includes the prior odds of one cause
        further = max(len(causes) - 1, 0) * np.log(prior_odds)
        log_evidence[causes] = np.array([each.log_evidence + further])
    probabilities = effect_probabilities(log_evidence, candidates)
    ranked = sorted(probabilities, key=lambda causes: -probabilities[causes])
    return {causes: probabilities[causes] for causes in ranked}


def most_probable_fit(
    compared: Mapping[tuple[str, ...], Comparison],
    probabilities: Mapping[tuple[str, ...], float],
) -> Comparison:
    """Return the most probable causes that were fitted, or no cause."""
    fitted = [c for c in probabilities if compared[c].estimate is not None]
    return compared[max(fitted, key=lambda causes: probabilities[causes])]


def decide(
    compared: Mapping[tuple[str, ...], Comparison],
    probabilities: Mapping[tuple[str, ...], float],
    tolerance_m: float,
    is_complete: bool,
    noise_ratios: NoiseRatios,
    is_checked: bool = True,
) -> tuple[str, str]:
    """Decide the verdict, and state it in words.

    noise_ratios: ratios of the most probable causes if they explain half of the misfit,
    else of no cause. is_checked: whether rivals were compared, or earlier trials showed
    the same causes.
    """
    base = compared[NO_CAUSE]
    assert base.estimate is not None
    best = most_probable_fit(compared, probabilities)
    if best.causes and explains_half(best, base):
        return _decide_about(
            best,
            base,
            probabilities,
            tolerance_m,
            is_complete,
            noise_ratios,
            is_checked,
        )
    if not is_complete:
        return "undecided", f"No cause was found; {TIME_IS_UP}."
    base_mm = MM_PER_M * tip_rms_m(base.estimate)
    has_small_misfit = (
        tip_rms_m(base.estimate) <= tolerance_m or noise_ratios.leave_only_mesh_error
    )
    if not has_small_misfit:
        return (
            "unknown",
            f"No single effect explains the tip's misfit of {base_mm:.1f} mm.",
        )
    if not noise_ratios.leave_only_noise:
        return (
            "unknown",
            "No single effect explains why the residual exceeds the noise.",
        )
    return (
        "none",
        "No cause is needed: the model leaves only noise where the mesh resolves it.",
    )


def _decide_about(
    best: Comparison,
    base: Comparison,
    probabilities: Mapping[tuple[str, ...], float],
    tolerance_m: float,
    is_complete: bool,
    noise_ratios: NoiseRatios,
    is_checked: bool,
) -> tuple[str, str]:
    """Decide whether to name the most probable causes, which explain half or more."""
    left_mm = MM_PER_M * tip_rms_m(best.estimate)
    base_mm = MM_PER_M * tip_rms_m(base.estimate)
    name = describe_causes(best.causes)
    effect = f"With {name} the tip is {left_mm:.1f} mm off instead of {base_mm:.1f}"
    has_small_misfit = tip_rms_m(best.estimate) <= tolerance_m
    is_explained = has_small_misfit or noise_ratios.leave_only_mesh_error
    if not is_complete and not is_explained:
        return "undecided", f"{effect}; {TIME_IS_UP}."
    probability = probabilities[best.causes]
    if probability < NAMED_PROBABILITY:
        others = []
        for causes, p in probabilities.items():
            if p >= MIXED_PROBABILITY:
                others.append(f"{describe_causes(causes)} ({p:.2f})")
        return "candidates", f"{effect}, but others may act: {', '.join(others)}."
    effect += f" (probability {probability:.2f})"
    if not is_explained:
        return "partial", f"{effect}; the rest is not explained."
    caveat = ""
    if not noise_ratios.leave_only_noise:
        caveat = "the residual exceeds the noise: other causes may act"
    elif not noise_ratios.explain_half:
        caveat = (
            "less than half of the misfit is explained where the error of the mesh is "
            "below the noise"
        )
    elif not is_checked:
        caveat = TIME_IS_UP
    if caveat:
        return "candidates", f"{effect}, but {caveat}."
    if not has_small_misfit:
        effect += "; the rest is the error of the mesh"
    return "cause", f"{effect}."
