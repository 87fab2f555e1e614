"""From fits to a verdict: probabilities, look-alikes, and whether anything in the library explains the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from stringcast.stages.diagnose.choose import noisiness
from stringcast.stages.diagnose.compare import blocks
from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.hypotheses import INEXACT, Causes, Hypotheses
from stringcast.stages.diagnose.noise import systematic

RESOLUTION = "resolution"
PARAMETER = 2.0  # of the log-likelihood: what a further parameter must gain
ALIKE = 0.05  # of the likeliest: sets of causes at least as likely as this cannot be told from it
STUBBORN = 0.01  # probability kept for each thing that was not foreseen
COARSE = 2.0  # mean square at the configured number of mass points over that at enough of them
STEEP = 4.0  # of the odds of something that the library does not hold, with what is left
LEFT = 0.06  # share of the misfit that a right cause may leave where something is still to be seen
CLEAN = 0.5  # of the logarithm of a mismatch: as far below 0 nothing is left, whatever its share, as far above much is


@dataclass(frozen=True)
class Judgement:
    """verdict: as in diagnosis.json. causes: named, the most needed first. probability: of effects, none and unknown,
    summing to one. groups: of effects that cannot be told apart. chances: of each set of causes. left: share of the
    systematic misfit that is not explained."""

    verdict: str
    causes: tuple[str, ...]
    probability: Mapping[str, float]
    groups: tuple[tuple[str, ...], ...]
    chances: Mapping[Causes, float]
    left: float


def judged(hypotheses: Hypotheses, causes: Causes, coarse: float) -> Judgement:
    """The verdict on the causes that were chosen.

    coarse: mean square of the configured model's residual over that of one with enough mass points.
    """
    base, fit = hypotheses.tried[frozenset()], hypotheses.tried[causes]
    before, after = (systematic(hypotheses.evidence, each.residual) for each in (base, fit))
    left = float(np.clip(after / before, 0, 1)) if before > 0 else 0.0
    seen = hypotheses.mismatch(causes)
    chances = _chances(hypotheses, causes)
    if not causes:
        return _nothing(seen, coarse, left, chances)
    dirty = float(np.clip(seen / CLEAN + 1, 0, 1))
    strange = float(expit(STEEP * (min(seen, CLEAN) + dirty * np.log(max(left, 1e-3) / LEFT))))
    groups = _groups(chances, causes)
    probability = _probability(chances, _silent(hypotheses, causes, groups), strange)
    if strange > 0.5:
        return _told(hypotheses, Judgement("unknown", (), probability, (), chances, left))
    need = {name: _needed(hypotheses, causes, name, probability) for name in causes.union(*groups)}
    ordered = tuple(sorted(need, key=lambda name: need[name], reverse=True))
    return _told(
        hypotheses, Judgement("ambiguous" if groups else "effect", ordered, probability, groups, chances, left)
    )


def _silent(hypotheses: Hypotheses, causes: Causes, groups: tuple[tuple[str, ...], ...]) -> frozenset[str]:
    """What is used beside causes of the string, and not named: of a simulation, and nobody's look-alike."""
    grouped = {name for group in groups for name in group}
    quiet = frozenset(name for name in causes - grouped if not hypotheses.library[name].of_string)
    return frozenset() if quiet == causes else quiet


def _told(hypotheses: Hypotheses, judgement: Judgement) -> Judgement:
    """With causes that are of a simulation and not of the string called `resolution`; beside others it is only used."""
    name = {
        each: each if each not in hypotheses.library or hypotheses.library[each].of_string else RESOLUTION
        for each in (*judgement.probability, *judgement.causes)
    }
    groups = tuple(tuple(dict.fromkeys(name[each] for each in group)) for group in judgement.groups)
    grouped = {each for group in groups for each in group}
    causes = tuple(dict.fromkeys(name[each] for each in judgement.causes))
    if len(causes) > 1:
        causes = tuple(each for each in causes if each != RESOLUTION or each in grouped)
    probability: dict[str, float] = {}
    for each, share in judgement.probability.items():
        probability[name[each]] = probability.get(name[each], 0.0) + share
    return replace(judgement, causes=causes, groups=groups, probability=probability)


def _nothing(seen: float, coarse: float, left: float, chances: Mapping[Causes, float]) -> Judgement:
    """No cause has earned its place: nothing is wrong, or too few mass points, or something unknown."""
    strange = float(expit(2 * STEEP * seen))
    few = float(expit(6 * np.log(coarse / COARSE)))
    probability = {"unknown": strange, RESOLUTION: (1 - strange) * few, "none": (1 - strange) * (1 - few)}
    likeliest = max(probability, key=lambda name: probability[name])
    if likeliest == RESOLUTION:
        return Judgement("effect", (RESOLUTION,), probability, (), chances, 0.0)
    return Judgement(likeliest, (), probability, (), chances, left if likeliest == "unknown" else 0.0)


def _chances(hypotheses: Hypotheses, causes: Causes) -> dict[Causes, float]:
    """Probability of every set of as many causes, given that one of them is right."""
    best = hypotheses.tried[causes]
    sets = {key: fit for key, fit in hypotheses.tried.items() if len(key) == len(causes)}
    odds = {key: log_odds(hypotheses, fit, best) for key, fit in sets.items()}
    chance = {key: float(np.exp(value - max(odds.values()))) for key, value in odds.items()}
    return {key: value / sum(chance.values()) for key, value in chance.items()}


def log_odds(hypotheses: Hypotheses, fit: Fit, best: Fit) -> float:
    """Of a fit against the best, no more certain than what the pieces of time say allows."""
    number = blocks(hypotheses.evidence)
    says = np.bincount(number, best.residual**2 - fit.residual**2) / 2
    apart = np.bincount(number, (best.residual - fit.residual) ** 2) / 2
    explained = hypotheses.tried[frozenset()].cost - best.cost
    more = fit.theory.parameters - best.theory.parameters
    return float(weighed(says, apart, explained, noisiness(hypotheses.evidence, best), more))


def weighed(says: np.ndarray, apart: np.ndarray, explained: np.ndarray | float, chance: float, more: int) -> np.ndarray:
    """Log odds from what each piece of time says for one of two fits, (K, ...), by log-likelihood.

    apart: half the sum of squares of what they differ by there, (K, ...). That is what a piece says if the better one
    is right, so that a touch may say all in two pieces; what is said differs from it where both are wrong, or by noise.
    Where that makes a standard deviation of s in the sum d, independent noise would have the odds at 2 (d / s)^2; but
    few pieces hardly know s, and the odds grow no faster than Student's t lets them. No model is exact: what it
    explains, it explains but for a small share. explained: gain of the log-likelihood by the better of them over the
    base model. chance: its `noisiness`. more: parameters that the one of which it is said has more than the other.
    """
    total = says.sum(axis=0) - PARAMETER * more * chance
    pieces = np.maximum(apart.sum(axis=0) ** 2 / np.maximum((apart**2).sum(axis=0), 1e-300), 1.0)
    scatter = np.sqrt(np.sum((says - np.sign(total) * apart) ** 2, axis=0))
    ratio = total / np.maximum(np.hypot(scatter, INEXACT * explained), 1e-9)
    allowed = pieces / 2 * np.log1p(4 * ratio**2 / pieces)
    return np.sign(total) * np.minimum(np.abs(total / chance), allowed)


def _probability(chances: Mapping[Causes, float], silent: frozenset[str], strange: float) -> dict[str, float]:
    """Of each effect, shared among those that a set needs together, but for the silent; of none and unknown."""
    strange = float(np.clip(strange, STUBBORN, 1 - STUBBORN))
    none = STUBBORN * (1 - strange)
    result = {"unknown": strange, "none": none}
    for some, chance in chances.items():
        named = some - silent or some
        for name in named:
            result[name] = result.get(name, 0.0) + chance * (1 - strange - none) / len(named)
    return result


def _groups(chances: Mapping[Causes, float], causes: Causes) -> tuple[tuple[str, ...], ...]:
    """Effects that could stand in place of one of the causes, with it; or of several, if only all of these together
    could be others."""
    groups: list[tuple[str, ...]] = []
    likely = [key for key, chance in chances.items() if key != causes and chance > ALIKE * chances[causes]]
    for gone in sorted({causes - key for key in likely}, key=lambda gone: (len(gone), sorted(gone))):
        if not gone & {name for group in groups for name in group}:
            come = frozenset().union(*(key - causes for key in likely if causes - key == gone))
            groups.append((*sorted(gone), *sorted(come)))
    return tuple(groups)


def _needed(hypotheses: Hypotheses, causes: Causes, name: str, probability: Mapping[str, float]) -> tuple[float, float]:
    """By what the cost rises without a cause; its look-alikes come after it, by probability."""
    rise = hypotheses.fit(causes - {name}, causes).cost - hypotheses.tried[causes].cost if name in causes else 0.0
    return rise, probability.get(name, 0.0)
