"""The quick comparison of causes: the most evident first, until the budget is used up.

Every effect is tried at a few sizes on a coarse mesh, and the other parameters follow
to first order. The most evident effects are then fitted as from nothing: a cause that
moves much, such as a heavy tip, moves the other parameters along, so that a fit that
begins nearby may end nearby.

The evidence is that of the Bayesian information criterion (Schwarz 1978) for
independent blocks of time. A diagnosis compares more carefully and takes minutes.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import (
    EXPLANATION_SUMMARY,
    EXPLANATIONS,
    Estimate,
    Explanation,
    Observation,
)
from stringcast.stages.common import Progress
from stringcast.stages.diagnose.probabilities import effect_probabilities
from stringcast.stages.diagnose.proposals import candidate_effects
from stringcast.stages.estimate.least_squares import estimate as fit_from_nothing
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood, time_blocks
from stringcast.stages.inference.mesh import mesh_ladder
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.search import with_estimated_noise
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL, forward_differences
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.model import Model

NAMED_PROBABILITY = 0.9  # of a cause that is named alone
MIXED_PROBABILITY = 0.05  # of a cause whose draws the next plan uses
MIN_EXPLAINED_FRACTION = 0.5  # of the mean square misfit, by a cause that is named
PROBE_FRACTIONS = (0.01, 0.03, 0.1, 0.3)  # of the way from absent to an amplitude
PROBES = 16
SLOPE_WIDTH = 0.01  # of exponents, over which slopes are taken
MAX_EXTRAPOLATION = 2.0  # of a probe's size, where it is still about linear
COARSE_LEVEL = 2  # of the mesh, halvings
NO_CAUSE = ""
TIME_IS_UP = "the processor time was used up before all likely causes were fitted"
MM_PER_M = 1e3


@dataclass(frozen=True)
class Comparison:
    """Comparison of one cause, or none, with the trials.

    Parameters
    ----------
    name : of the effect; empty for the model as it was
    log_evidence : gain over the model as it was; to first order without an estimate
    estimate : of the model with the cause, where it was fitted from nothing
    """

    name: str
    log_evidence: float
    estimate: Estimate | None = None


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit from nothing, as of `least_squares.estimate`."""

    seed: int
    manipulation: int
    starts: int
    screening: int
    iterations: int
    matching: Matching


def explain(
    model: Model,
    observations: Sequence[Observation],
    estimate: Estimate,
    previous: Explanation | None,
    is_surprising: bool,
    tolerance_m: float,
    *,
    seed: int,
    manipulation: Annotated[int, Field(ge=1)],
    seconds: Annotated[float, Field(ge=0)],
    finalists: Annotated[int, Field(ge=1)],
    starts: Annotated[int, Field(ge=1)],
    screening: Annotated[int, Field(ge=1)],
    iterations: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Explanation:
    """Find the cause of trials that surprise or that the estimate does not explain.

    Parameters
    ----------
    model : Model
        Without the cause.
    observations : sequence of Observation
        The trials.
    estimate : Estimate
        Of the model from these trials.
    previous : Explanation or None
        Of earlier trials; its causes are fitted first.
    is_surprising : bool
        Whether the last trial was not within what was predicted.
    tolerance_m : float
        Tip misfit that does not matter [m].
    seed, manipulation : int
        Of the random starts.
    seconds : float
        Processor time after which no further cause is fitted [s].
    finalists : int
        Number of the most evident causes, which are fitted as if nothing were known.
    starts, screening, iterations, matching
        Of such a fit, as of `least_squares.estimate`.
    progress : callable
        Called with the share of the budget that is used.

    Returns
    -------
    Explanation
        The estimate that the next plan uses, with causes and their probabilities.
    """
    began = time.process_time()
    settings = FitSettings(seed, manipulation, starts, screening, iterations, matching)
    before = {} if previous is None else previous.causes
    earlier = [name for name, p in before.items() if p >= MIXED_PROBABILITY]
    explains = tip_rms_m(estimate) <= tolerance_m
    if explains and not is_surprising and not earlier:
        return not_asked(estimate)

    def time_used() -> float:
        used = time.process_time() - began
        progress(min(used / max(seconds, 1e-9), 1.0))
        return used

    trials = [prepare_trial(model, observation) for observation in observations]
    effects = candidate_effects(model, effects_by_name(), trials)
    blocks = int(time_blocks(trials).max()) + 1
    fitted = {NO_CAUSE: Comparison(NO_CAUSE, 0.0, estimate)}
    compare = Comparer(model, observations, estimate, blocks, settings)
    for effect in find_effects(earlier):
        fitted[effect.name] = compare.fit(effect)
    is_enough = any(tip_rms_m(each.estimate) <= tolerance_m for each in fitted.values())

    is_complete = True
    screened: dict[str, Comparison] = {}
    if is_surprising or not is_enough:
        for effect in effects:
            screened[effect.name] = compare.screen(effect)
            time_used()
        ranked = sorted(screened.values(), key=lambda each: -each.log_evidence)
        for each in ranked[:finalists]:
            if time_used() > seconds:
                is_complete = False
                break
            if each.name not in fitted:
                fitted[each.name] = compare.fit(*find_effects([each.name]))
    # a cause that was not fitted is as evident as it seems to first order
    compared = screened | fitted
    probabilities = posterior_probabilities(compared, len(effects))
    verdict, sentence = decide(compared, probabilities, tolerance_m, is_complete)
    finding = {
        "verdict": verdict,
        "candidates": len(effects),
        "fitted": len(fitted) - 1,
        "sentence": sentence,
    }
    if verdict == "none":
        compared = {NO_CAUSE: fitted[NO_CAUSE]}
        probabilities = {NO_CAUSE: 1.0}
    return build_explanation(model, compared, probabilities, finding, seed)


@dataclass(frozen=True)
class Comparer:
    """Compare causes by the same trials.

    Parameters
    ----------
    model : without a cause
    observations : the trials
    estimate : of the model without a cause
    blocks : number of independent blocks of time in the trials
    settings : of the fits
    """

    model: Model
    observations: Sequence[Observation]
    estimate: Estimate
    blocks: int
    settings: FitSettings

    def log_evidence(self, square_ratio: float, parameters: int) -> float:
        """Compute the gain in log evidence by a mean square that falls to a ratio."""
        gain = self.blocks * -np.log(max(square_ratio, np.finfo(float).tiny))
        return float(gain - 0.5 * parameters * np.log(self.blocks))

    def screen(self, effect: type[Effect]) -> Comparison:
        """Compute the evidence of an effect to first order, on a coarse mesh."""
        hypothesis = Hypothesis(self.model).with_cause(effect)
        trials = [prepare_trial(hypothesis.model, o) for o in self.observations]
        likelihood = Likelihood(TrialData(tuple(trials)), hypothesis.model)
        ladder = mesh_ladder(likelihood)
        coarse = ladder[min(COARSE_LEVEL, len(ladder) - 1)]
        fitted = self.estimate.parameters
        exponents = dict(zip(fitted["name"], fitted["chi"], strict=True))
        start = hypothesis.exponents_from(exponents)
        coarse = with_estimated_noise(coarse, start)

        probes = self._probes(hypothesis, effect, start)
        residuals = coarse.residuals(np.concatenate([start[None], probes]))
        unfitted, probed = residuals[0], residuals[1:]  # (N,) and (C, N)
        is_finite = (probed != DIVERGED_RESIDUAL).all(axis=1)
        widths = np.full((1, len(start)), SLOPE_WIDTH)
        slopes = forward_differences(coarse, start[None], unfitted[None], widths)[0]
        followed, _ = np.linalg.qr(slopes[hypothesis.base_indices].T)  # (N, P)

        # what is left, and what a probe changes, once the other parameters follow
        rows = np.concatenate([unfitted[None], probed[is_finite] - unfitted])
        rows = rows - (rows @ followed) @ followed.T
        remainder, response = rows[0], rows[1:]
        square = np.sum(response**2, axis=1) + np.finfo(float).tiny
        factor = np.clip(-(response @ remainder) / square, 0, MAX_EXTRAPOLATION)
        left = np.mean((remainder + factor[:, None] * response) ** 2, axis=1)
        ratio = left.min(initial=np.inf) / np.mean(remainder**2)
        evidence = self.log_evidence(min(ratio, 1.0), len(effect.parameters))
        return Comparison(effect.name, evidence)

    def _probes(
        self, hypothesis: Hypothesis, effect: type[Effect], start: np.ndarray
    ) -> np.ndarray:
        """Choose exponents (C, P) at which an effect acts, near the estimate."""
        rng = np.random.default_rng([self.settings.seed, PROBES])
        own = hypothesis.parameter_indices(effect, effect.parameters)
        amplitudes = hypothesis.amplitude_indices(effect)
        probes = np.tile(start, (PROBES, 1))
        probes[:, own] = rng.uniform(0, 1, (PROBES, len(own)))
        # half of them to either end of the range of the first amplitude
        probes[::2, amplitudes[0]] = 0.0
        probes[1::2, amplitudes[0]] = 1.0
        fractions = np.repeat(PROBE_FRACTIONS, PROBES // len(PROBE_FRACTIONS))[:, None]
        distance = probes[:, amplitudes] - start[amplitudes]
        probes[:, amplitudes] = start[amplitudes] + fractions * distance
        return probes

    def fit(self, effect: type[Effect]) -> Comparison:
        """Fit the model with an effect as if nothing were known."""
        settings = self.settings
        made = fit_from_nothing(
            self.model.with_effects(effect),
            self.observations,
            self.estimate,
            seed=settings.seed,
            manipulation=settings.manipulation,
            starts=settings.starts,
            screening=settings.screening,
            iterations=settings.iterations,
            matching=settings.matching,
        )
        ratio = (rms_m(made) / rms_m(self.estimate)) ** 2
        evidence = self.log_evidence(ratio, len(effect.parameters))
        return Comparison(effect.name, evidence, made)


def rms_m(estimate: Estimate) -> float:
    """Return the residual of the centre-line, root mean square [m]."""
    return float(estimate.fit["rms_after"].iloc[0])


def tip_rms_m(estimate: Estimate | None) -> float:
    """Return the residual of the tip, root mean square [m]; NaN without a fit."""
    return np.nan if estimate is None else float(estimate.fit["tip_after"].iloc[0])


def posterior_probabilities(
    compared: Mapping[str, Comparison], candidates: int
) -> dict[str, float]:
    """Compute the probability of each cause and of none, the most probable first."""
    log_evidence = {}
    for name, each in compared.items():
        log_evidence[name] = np.array([each.log_evidence])
    probabilities = effect_probabilities(log_evidence, candidates)
    ranked = sorted(probabilities, key=lambda name: -probabilities[name])
    return {name: probabilities[name] for name in ranked}


def decide(
    compared: Mapping[str, Comparison],
    probabilities: Mapping[str, float],
    tolerance_m: float,
    is_complete: bool,
) -> tuple[str, str]:
    """Decide the verdict, and state it in words."""
    base = compared[NO_CAUSE].estimate
    assert base is not None
    best = next(iter(probabilities))
    found = compared[best].estimate
    if best and found is not None:
        explained = 1 - (rms_m(found) / rms_m(base)) ** 2
        if explained >= MIN_EXPLAINED_FRACTION:
            return _decide_about(found, base, probabilities, tolerance_m, is_complete)
    if not is_complete:
        return "undecided", f"No cause was found; {TIME_IS_UP}."
    base_mm = MM_PER_M * tip_rms_m(base)
    if tip_rms_m(base) > tolerance_m:
        return (
            "unknown",
            f"No single effect explains why the tip is {base_mm:.1f} mm off.",
        )
    return "none", "No cause is needed: the trials agree with the model."


def _decide_about(
    found: Estimate,
    base: Estimate,
    probabilities: Mapping[str, float],
    tolerance_m: float,
    is_complete: bool,
) -> tuple[str, str]:
    """Decide whether the most probable cause, which explains much, is named."""
    best = next(iter(probabilities))
    left_mm, base_mm = MM_PER_M * tip_rms_m(found), MM_PER_M * tip_rms_m(base)
    effect = f"With {best} the tip is {left_mm:.1f} mm off instead of {base_mm:.1f}"
    is_explained = tip_rms_m(found) <= tolerance_m
    if not is_complete and not is_explained:
        return "undecided", f"{effect}; {TIME_IS_UP}."
    if probabilities[best] < NAMED_PROBABILITY:
        others = [
            f"{name or 'none'} ({p:.2f})"
            for name, p in probabilities.items()
            if p >= MIXED_PROBABILITY
        ]
        return "candidates", f"{effect}, but others may act: {', '.join(others)}."
    probability = f"(probability {probabilities[best]:.2f})"
    if is_explained:
        return "cause", f"{effect} {probability}."
    return "partial", f"{effect} {probability}; something else is left."


def not_asked(estimate: Estimate) -> Explanation:
    """Return the estimate as it is: nothing needs an explanation."""
    finding = {
        "verdict": "not asked",
        "candidates": 0,
        "fitted": 0,
        "sentence": "The model explains the trials; no cause was sought.",
    }
    table = EXPLANATION_SUMMARY.check(pd.DataFrame([finding]))
    return Explanation(**estimate_tables(estimate), finding=table)


def estimate_tables(estimate: Estimate) -> dict[str, pd.DataFrame]:
    """Return the tables of an estimate by the names of its fields."""
    return {name: getattr(estimate, name) for name in Estimate.TABLES}


def build_explanation(
    model: Model,
    compared: Mapping[str, Comparison],
    probabilities: Mapping[str, float],
    finding: Mapping[str, object],
    seed: int,
) -> Explanation:
    """Build the artifact from the most probable fit and draws of all probable ones."""
    mixed: dict[str, tuple[float, Estimate]] = {}
    for name, probability in probabilities.items():
        fit = compared[name].estimate
        if fit is not None and (probability >= MIXED_PROBABILITY or not mixed):
            mixed[name] = probability, fit
    best = next(iter(mixed.values()))[1]
    estimate = with_absent_effects(model, best, [name for name in mixed if name])
    draws = mix_draws(mixed, estimate, seed)

    rows = []
    for name, probability in probabilities.items():
        each = compared[name]
        rows.append(
            {
                "effect": name,
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
    """Add the parameters of effects that are absent from an estimate."""
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
    mixed: Mapping[str, tuple[float, Estimate]], whole: Estimate, seed: int
) -> pd.DataFrame:
    """Draw from several estimates as often as each is probable.

    Parameters that an estimate does not have are where their effect is absent.
    """
    absent = whole.values()
    for name, (_, fit) in mixed.items():
        if name:
            known = fit.values()
            (effect,) = find_effects([name])
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
