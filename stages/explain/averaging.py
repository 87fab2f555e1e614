"""The artifact of an explanation: draws are averaged over the probable causes.

In Bayesian model averaging, each set of causes gives draws in proportion to its
probability (Hoeting, Madigan, Raftery, Volinsky, Statistical Science 14, 382, 1999).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.data.estimates import Estimate
from stringcast.data.explanations import EXPLANATION_SUMMARY, EXPLANATIONS, Explanation
from stringcast.stages.estimate.result import Interval, parameter_table
from stringcast.stages.explain.comparison import Causes, tip_rms_m
from stringcast.stages.explain.decision import MIXED_PROBABILITY, Evidence
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_exponents


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


def average_over_causes(
    model: Model, evidence: Evidence, finding: Mapping[str, object], seed: int
) -> Explanation:
    """Build the artifact from the best fit, with draws from all probable fits.

    Parameters
    ----------
    model : Model
        Model without causes.
    evidence : Evidence
        The compared causes with their probabilities.
    finding : mapping
        The row of the table EXPLANATION_SUMMARY.
    seed : int
        Seed of the choice of draws.
    """
    mixed: dict[Causes, tuple[float, Estimate]] = {}  # probability and fit
    least_mixed = MIXED_PROBABILITY * sum(evidence.probabilities.values())
    rows = []
    for causes, probability in evidence.probabilities.items():
        comparison = evidence.compared[causes]
        fit = comparison.estimate
        if fit is not None and (probability >= least_mixed or not mixed):
            mixed[causes] = probability, fit
        row = {
            "effects": " ".join(causes),
            "probability": probability,
            "log_evidence": comparison.log_evidence,
            "tip_rms": tip_rms_m(fit),
            "fitted": fit is not None,
        }
        rows.append(row)
    _, best = next(iter(mixed.values()))
    names = dict.fromkeys(name for causes in mixed for name in causes)
    estimate = with_absent_effects(model, best, list(names))
    draws = mix_draws(mixed, estimate, seed)
    return Explanation(
        **estimate_tables(replace(estimate, draws=draws)),
        explanations=EXPLANATIONS.check(pd.DataFrame(rows)),
        finding=EXPLANATION_SUMMARY.check(pd.DataFrame([finding])),
    )


def estimate_tables(estimate: Estimate) -> dict[str, pd.DataFrame]:
    """Return the tables of an estimate by the names of its fields."""
    return {name: getattr(estimate, name) for name in Estimate.TABLES}


def with_absent_effects(
    model: Model, estimate: Estimate, names: Sequence[str]
) -> Estimate:
    """Add the parameters of effects that an estimate does not have, as absent."""
    known = set(estimate.parameters["name"])
    added = [effect for effect in find_effects(names) if effect not in model.effects]
    extended = model.with_effects(*added)
    absent = [p for p in extended.parameters if p.name not in known]
    if not absent:
        return estimate
    starts = np.array([parameter.start for parameter in absent])
    unknown = np.full(len(absent), np.nan)
    interval = Interval(unknown, unknown, np.zeros(len(absent), dtype=bool), "")
    table = parameter_table(absent, parameter_exponents(absent, starts), interval)
    # exact starts, because an effect is absent at exactly zero
    table = table.assign(value=starts, at_bound=False)
    parameters = pd.concat([estimate.parameters, table], ignore_index=True)
    columns = dict(zip(table["name"], starts, strict=True))
    candidates = estimate.candidates.assign(**columns)
    return replace(estimate, parameters=parameters, candidates=candidates)


def mix_draws(
    mixed: Mapping[Causes, tuple[float, Estimate]], whole: Estimate, seed: int
) -> pd.DataFrame:
    """Mix draws of several estimates in proportion to their probability.

    Effects that an estimate does not have are absent in its draws.

    Parameters
    ----------
    mixed : mapping to tuple of float and Estimate
        Probability and estimate of each set of causes.
    whole : Estimate
        An estimate with the parameters of all these causes.
    seed : int
        Seed of the choice of draws.
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
