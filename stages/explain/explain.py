"""Quick search for the causes of surprising trials, between the casts of a loop.

It keeps to a budget of processor time. A diagnosis compares more carefully and takes
minutes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import EXPLANATION_SUMMARY, EXPLANATIONS, Explanation
from stringcast.stages.common import Progress
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.estimate.least_squares import MISFIT_RATIO
from stringcast.stages.estimate.least_squares import estimate as fit_from_nothing
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.explain.cause_search import Budget, CauseSearch, Finalist
from stringcast.stages.explain.comparison import (
    NO_CAUSE,
    Comparer,
    Comparison,
    explains_half,
    noise_m,
    rms_m,
    tip_rms_m,
    without_causes,
)
from stringcast.stages.explain.decision import (
    MIXED_PROBABILITY,
    decide,
    most_probable_fit,
    posterior_probabilities,
)
from stringcast.stages.explain.noise_ratios import compare_with_noise
from stringcast.stages.inference.likelihood import time_blocks
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
    cast_number: Annotated[int, Field(ge=1)],
    seconds: Annotated[float, Field(ge=0)],
    finalists: Annotated[int, Field(ge=1)],
    starts: Annotated[int, Field(ge=1)],
    screening: Annotated[int, Field(ge=1)],
    iterations: Annotated[int, Field(ge=1)],
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
    comparer = Comparer(model, observations, base, base.rms_m, blocks, fit_model, seed)
    fitted = {NO_CAUSE: base}
    if earlier:
        with budget.measure_fit():
            known = comparer.fit(find_effects(earlier[0]), previous)
        fitted[known.causes] = known

    search = CauseSearch(
        comparer, effects, fitted, finalists, budget, is_surprising, earlier
    )
    if previous is not None and earlier:
        search.rivals = rivals_of_earlier(previous, earlier, comparer, known)
    search.search(tolerance_m)
    compared = search.explaining()
    probabilities = posterior_probabilities(compared, len(effects))
    best = most_probable_fit(compared, probabilities)
    explaining = best if explains_half(best, base) else base
    noise_ratios = search.noise_ratios_of(explaining)
    # several false effects together may fit a few trials, so rivals must be compared
    is_named = previous is not None and previous.named_causes == best.causes
    is_checked = (
        is_named
        or len(best.causes) == 1
        or search.is_confirmed(best)
        or search.are_rivals_compared(best, tolerance_m)
    )
    verdict, sentence = decide(
        compared,
        probabilities,
        tolerance_m,
        search.is_complete,
        noise_ratios,
        is_checked,
    )
    finding = {
        "verdict": verdict,
        "candidates": len(effects),
        "fitted": sum(each.estimate is not None for each in compared.values()) - 1,
        "sentence": sentence,
        "rms_without": rms_m(estimate),
    }
    if verdict == "none":
        compared = {NO_CAUSE: base}
        probabilities = {NO_CAUSE: 1.0}
    return build_explanation(model, compared, probabilities, finding, seed)


def reason_for_no_search(
    model: Model, observations: Sequence[Observation], estimate: Estimate
) -> str:
    """Return why an estimate needs no cause; empty if it may need one."""
    if rms_m(estimate) <= MISFIT_RATIO * noise_m(observations):
        return "The model explains the trials"
    noise_ratios = compare_with_noise(model, observations, [estimate])
    if noise_ratios.leave_only_mesh_error:
        return "The model leaves only the error of its mesh"
    return ""


def earlier_causes(previous: Explanation) -> list[tuple[str, ...]]:
    """List the causes that were likely before; these are fitted first."""
    likely = []
    for causes, probability in previous.cause_sets.items():
        if causes and probability >= MIXED_PROBABILITY:
            likely.append(causes)
    return likely


def rivals_of_earlier(
    previous: Explanation,
    likely: Sequence[tuple[str, ...]],
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


def estimate_without_causes(estimate: Estimate, reason: str) -> Explanation:
    """Build the explanation of trials that need no cause."""
    finding = {
        "verdict": "not asked",
        "candidates": 0,
        "fitted": 0,
        "sentence": f"{reason}; no cause was searched for.",
    }
    table = EXPLANATION_SUMMARY.check(pd.DataFrame([finding]))
    return Explanation(**estimate_tables(estimate), finding=table)


def estimate_tables(estimate: Estimate) -> dict[str, pd.DataFrame]:
    """Return the tables of an estimate by the names of its fields."""
    return {name: getattr(estimate, name) for name in Estimate.TABLES}


def build_explanation(
    model: Model,
    compared: Mapping[tuple[str, ...], Comparison],
    probabilities: Mapping[tuple[str, ...], float],
    finding: Mapping[str, object],
    seed: int,
) -> Explanation:
    """Build the artifact from the best fit, with draws from all probable fits."""
    mixed: dict[tuple[str, ...], tuple[float, Estimate]] = {}
    for causes, probability in probabilities.items():
        fit = compared[causes].estimate
        if fit is not None and (probability >= MIXED_PROBABILITY or not mixed):
            mixed[causes] = probability, fit
    best = next(iter(mixed.values()))[1]
    names = dict.fromkeys(name for causes in mixed for name in causes)
    estimate = with_absent_effects(model, best, list(names))
    draws = mix_draws(mixed, estimate, seed)

    rows = []
    for causes, probability in probabilities.items():
        each = compared[causes]
        rows.append(
            {
                "effects": " ".join(causes),
                "probability": probability,
                "log_evidence": each.log_evidence,
                "tip_rms": tip_rms_m(each.estimate),
                "fitted": each.estimate is not None,
            }
        )
    return Explanation(
        **estimate_tables(replace(estimate, draws=draws)),
        explanations=EXPLANATIONS.check(pd.DataFrame(rows)),
        finding=EXPLANATION_SUMMARY.check(pd.DataFrame([finding])),
    )


def with_absent_effects(
    model: Model, estimate: Estimate, names: Sequence[str]
) -> Estimate:
    """Add the parameters of effects that an estimate does not have, as absent."""
    known = set(estimate.parameters["name"])
    rows = [estimate.parameters]
    candidates = estimate.candidates
    for effect in find_effects(names):
        if known >= {effect.qualified_name(p) for p in effect.parameters}:
            continue
        extended = model.with_effects(effect)
        for parameter in extended.parameters:
            if parameter.name in known:
                continue
            row = {
                "name": parameter.name,
                "symbol": parameter.symbol,
                "unit": parameter.unit,
                "meaning": parameter.meaning,
                "value": parameter.start,
                "low": np.nan,
                "high": np.nan,
                "minimum": parameter.low,
                "maximum": parameter.high,
                "chi": float(parameter.chi(np.asarray(parameter.start))),
                "at_bound": False,
                "determined": False,
            }
            rows.append(pd.DataFrame([row]))
            candidates = candidates.assign(**{parameter.name: parameter.start})
    parameters = pd.concat(rows, ignore_index=True)
    return replace(estimate, parameters=parameters, candidates=candidates)


def mix_draws(
    mixed: Mapping[tuple[str, ...], tuple[float, Estimate]], whole: Estimate, seed: int
) -> pd.DataFrame:
    """Mix draws of several estimates in proportion to their probability.

    Effects that an estimate does not have are absent in its draws.
    """
    absent = whole.values()
    for causes, (_, fit) in mixed.items():
        known = fit.values()
        for effect in find_effects(causes):
            for parameter in effect.parameters:
                qualified = effect.qualified_name(parameter)
                if qualified in known:
                    absent[qualified] = parameter.start
    weights = np.array([probability for probability, _ in mixed.values()])
    count = len(whole.draws)
    rng = np.random.default_rng([seed, count])
    chosen = rng.choice(len(mixed), count, p=weights / weights.sum())
    parts = []
    for number, (_, fit) in enumerate(mixed.values()):
        wanted = int((chosen == number).sum())
        rows = rng.integers(0, len(fit.draws), wanted)
        part = fit.draws.iloc[rows]
        missing = {
            name: value for name, value in absent.items() if name not in part.columns
        }
        parts.append(part.assign(**missing))
    draws = pd.concat(parts, ignore_index=True)[["draw", *absent]]
    return draws.assign(draw=np.arange(len(draws)))
