"""Probabilities of the causes that were compared, and the verdict on them."""

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

NAMED_PROBABILITY = 0.9  # of causes that are named alone
MIXED_PROBABILITY = 0.05  # of causes whose draws the next plan uses
TIME_IS_UP = "the processor time was used up before all likely causes were fitted"


def posterior_probabilities(
    compared: Mapping[tuple[str, ...], Comparison], candidates: int
) -> dict[tuple[str, ...], float]:
    """Compute the probability of all compared causes, the most probable first.

    Effects are active independently of each other before the trials.
    """
    prior_odds = (1 - PRIOR_NO_EFFECT) / candidates / PRIOR_NO_EFFECT
    log_evidence = {}
    for causes, each in compared.items():
        # that of one cause is counted in any case
        further = max(len(causes) - 1, 0) * np.log(prior_odds)
        log_evidence[causes] = np.array([each.log_evidence + further])
    probabilities = effect_probabilities(log_evidence, candidates)
    ranked = sorted(probabilities, key=lambda causes: -probabilities[causes])
    return {causes: probabilities[causes] for causes in ranked}


def decide(
    compared: Mapping[tuple[str, ...], Comparison],
    probabilities: Mapping[tuple[str, ...], float],
    tolerance_m: float,
    is_complete: bool,
    noise_ratios: NoiseRatios,
    is_checked: bool = True,
) -> tuple[str, str]:
    """Decide the verdict, and state it in words.

    noise_ratios: of the most probable causes if they explain half of the misfit, else
    of no cause. is_checked: whether rivals of these causes were sought, or earlier
    trials showed them.
    """
    base = compared[NO_CAUSE]
    assert base.estimate is not None
    best = compared[next(iter(probabilities))]
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
    is_near = tip_rms_m(base.estimate) <= tolerance_m or noise_ratios.leave_mesh_error
    if not is_near:
        return (
            "unknown",
            f"No single effect explains why the tip is {base_mm:.1f} mm off.",
        )
    if not noise_ratios.are_noise:
        return "unknown", "No single effect explains why more than noise is left."
    return (
        "none",
        "No cause is needed: the model leaves only noise where it is resolved.",
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
    """Decide whether the most probable causes, which explain much, are named."""
    left_mm = MM_PER_M * tip_rms_m(best.estimate)
    base_mm = MM_PER_M * tip_rms_m(base.estimate)
    name = describe_causes(best.causes)
    effect = f"With {name} the tip is {left_mm:.1f} mm off instead of {base_mm:.1f}"
    is_near = tip_rms_m(best.estimate) <= tolerance_m
    is_explained = is_near or noise_ratios.leave_mesh_error
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
        return "partial", f"{effect}; something else is left."
    caveat = ""
    if not noise_ratios.are_noise:
        caveat = "more than noise is left: others may act"
    elif not noise_ratios.explain_half:
        caveat = (
            "less than half of the misfit is explained where the error of the mesh is "
            "below the noise"
        )
    elif not is_checked:
        caveat = TIME_IS_UP
    if caveat:
        return "candidates", f"{effect}, but {caveat}."
    if not is_near:
        effect += "; what is left is the error of the mesh"
    return "cause", f"{effect}."
