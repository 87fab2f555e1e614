"""Quick search for the causes of surprising trials, between the casts of a loop.

It keeps to a budget of processor time. A diagnosis compares more carefully and takes
minutes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import NonNegativeFloat, PositiveInt

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Explanation, describe_bases
from stringcast.stages.common import Progress
from stringcast.stages.diagnose.search.proposals import candidate_effects
from stringcast.stages.estimate.least_squares import estimate as fit_from_nothing
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.explain.averaging import (
    average_over_causes,
    estimate_without_causes,
)
from stringcast.stages.explain.budget import Budget
from stringcast.stages.explain.cause_search import CauseSearch, Finalist
from stringcast.stages.explain.comparer import Comparer
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Causes,
    Comparison,
    explains_half,
    without_causes,
)
from stringcast.stages.explain.decision import (
    MIXED_PROBABILITY,
    Evidence,
    decide,
    most_probable_fit,
    posterior_probabilities,
)
from stringcast.stages.explain.noise_ratios import compare_with_noise
from stringcast.stages.inference.likelihood import time_blocks
from stringcast.stages.inference.mesh_limit import MISFIT_RATIO
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.model import Model


def explain(
    model: Model,
    observations: Sequence[Observation],
    estimate: Estimate,
    previous: Explanation | None,
    is_surprising: bool,
    tolerance_m: float,
    *,
    seed: int,
    cast_number: PositiveInt,
    seconds: NonNegativeFloat,
    finalists: PositiveInt,
    starts: PositiveInt,
    screening: PositiveInt,
    iterations: PositiveInt,
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Explanation:
    """Find causes of trials that are a surprise or that the estimate does not explain.

    Parameters
    ----------
    model : Model
        Model without causes.
    observations : sequence of Observation
        The trials.
    estimate : Estimate
        Estimate of the model from these trials.
    previous : Explanation or None
        Explanation of earlier trials; its causes are fitted first.
    is_surprising : bool
        Whether the last trial disagreed with its prediction.
    tolerance_m : float
        Tip misfit that is small [m].
    seed, cast_number : int
        Seeds of the random starts.
    seconds : float
        Processor time after which no further cause is fitted [s].
    finalists : int
        Largest number of effects that are fitted after a screening.
    starts, screening, iterations, matching
        Settings of a fit, as in `least_squares.estimate`.
    progress : callable
        Called with the used share of the budget.

    Returns
    -------
    Explanation
        Estimate for the next plan, with causes and their probabilities.
    """
    budget = Budget(seconds, progress)
    earlier = [] if previous is None else earlier_causes(previous)
    if not is_surprising and not earlier:
        reason = reason_for_no_search(model, observations, estimate)
        if reason:
            return estimate_without_causes(estimate, reason)

    # Candidate effects, and comparisons without causes and with the earlier ones
    trials = [prepare_trial(model, observation) for observation in observations]
    effects = candidate_effects(model, effects_by_name(), trials)
    blocks = int(time_blocks(trials).max()) + 1
    base = without_causes(estimate)
    fit_model = partial(
        fit_from_nothing,
        seed=seed,
        cast_number=cast_number,
        starts=starts,
        screening=screening,
        iterations=iterations,
        matching=matching,
    )
    ratio = base.residual_ratio
    comparer = Comparer(model, observations, base, ratio, blocks, fit_model, seed)
    fitted = {NO_CAUSE: base}
    rivals: list[Finalist] = []
    if previous is not None and earlier:
        with budget.measure_fit():
            known = comparer.fit(find_effects(earlier[0]), previous)
        fitted[known.causes] = known
        rivals = rivals_of_earlier(previous, earlier, comparer, known)

    search = CauseSearch(
        comparer,
        effects,
        fitted,
        max_finalists=finalists,
        tolerance_m=tolerance_m,
        budget=budget,
        is_surprising=is_surprising,
        earlier=earlier,
        rivals=rivals,
        screened_earlier=[] if previous is None else previous.screened_bases,
    )
    search.run()
    evidence = weigh_evidence(search, previous)
    verdict, sentence = decide(evidence)
    fits = [c for c in evidence.compared.values() if c.estimate is not None]
    finding = {
        "verdict": verdict,
        "candidates": len(effects),
        "fitted": len(fits) - 1,
        "sentence": sentence,
        "rms_without": estimate.model_error_m,
        "screened": describe_bases({*search.screened_earlier, *search.screenings}),
    }
    if verdict == "none":
        evidence = replace(evidence, probabilities={NO_CAUSE: 1.0})
    return average_over_causes(model, evidence, finding, seed)


def weigh_evidence(search: CauseSearch, previous: Explanation | None) -> Evidence:
    """Compute the probabilities of the compared causes, and the numbers that decide."""
    compared = search.comparisons_without_idle_causes()
    probabilities = posterior_probabilities(compared, len(search.effects))
    best = most_probable_fit(compared, probabilities)
    base = compared[NO_CAUSE]
    was_named = previous is not None and previous.named_causes == best.causes
    untried = 0.0
    if not (was_named and search.is_explained(best)):
        untried = search.untried_share()
        probabilities = posterior_probabilities(compared, len(search.effects), untried)
    # Several false effects together may fit a few trials, so rivals must be compared
    is_checked = (
        was_named
        or len(best.causes) == 1
        or search.is_confirmed(best)
        or search.is_exchanged(best)
    )
    noise_ratios = search.noise_ratios_of(best if explains_half(best, base) else base)
    return Evidence(
        compared,
        probabilities,
        noise_ratios,
        tolerance_m=search.tolerance_m,
        is_complete=search.is_complete,
        is_checked=is_checked,
        untried_probability=untried,
    )


def reason_for_no_search(
    model: Model, observations: Sequence[Observation], estimate: Estimate
) -> str:
    """Return why an estimate needs no cause; empty if it may need one."""
    if estimate.residual_ratio <= MISFIT_RATIO:
        return "The model explains the trials"
    noise_ratios = compare_with_noise(model, observations, [estimate])
    if noise_ratios.leave_only_mesh_error:
        return "The model leaves only the error of its mesh"
    return ""


def earlier_causes(previous: Explanation) -> list[Causes]:
    """List the causes that were likely before; these are fitted first."""
    compared = sum(previous.cause_sets.values())
    likely = []
    for causes, probability in previous.cause_sets.items():
        if causes and probability >= MIXED_PROBABILITY * compared:
            likely.append(causes)
    return likely


def rivals_of_earlier(
    previous: Explanation,
    likely: Sequence[Causes],
    comparer: Comparer,
    best: Comparison,
) -> list[Finalist]:
    """List the rivals of the most probable causes of earlier trials.

    Until they are fitted again, they keep the ratios of their evidence, and so of their
    probabilities, in earlier trials. Their residual in these trials is not known.
    """
    evidences = previous.explanations["log_evidence"]
    before = dict(zip(previous.cause_sets, evidences, strict=True))
    rivals = []
    for causes in likely[1:]:
        deficit = float(before[likely[0]] - before[causes])
        compared = Comparison(causes, best.log_evidence - deficit, np.nan)
        rivals.append(Finalist(find_effects(causes), comparer, compared))
    return rivals
