"""What the data say of every effect: probabilities, look-alikes, and whether more is left than is tolerated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from stringcast.stages.diagnose.single_effects import (
    Criteria,
    Found,
    Step,
    compared,
    moved,
    refitted,
    removed,
    unexplained,
)
from stringcast.stages.diagnose.small_effects import gains, responses
from stringcast.stages.inference.evidence import DRAWS, Fit, evaluated, fitted, tip_draws
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.effect import Effect

RESOLUTION = "resolution"
NOTHING = 0.5  # probability, before the data speak, that a simulation lacks nothing of the library
SAMPLES = 100  # of trials that might have been: probabilities are told to 0.05


@dataclass(frozen=True)
class Slot:
    """One effect of the sum. chances: of each candidate, and of none (""), summing to one. fits: of those fitted. less:
    the fit with none."""

    chances: Mapping[str, float]
    fits: Mapping[str, Fit]
    less: Fit

    def credible(self, coverage: float) -> tuple[str, ...]:
        """The fewest candidates that hold so much of the probability, the likeliest first."""
        ranked = sorted(self.chances, key=lambda name: -self.chances[name])
        held = np.cumsum([self.chances[name] for name in ranked])
        return tuple(ranked[: int(np.searchsorted(held, coverage * held[-1])) + 1])


@dataclass(frozen=True)
class Judgement:
    """verdict: as in diagnosis.json. causes: named, as they entered, and those that cannot be told from them. groups:
    of effects that cannot be told apart. inclusion: probability that each effect is at work. unknown: probability that
    more is left at the tip than is tolerated. base: the base model's fit to the same data. small: what other effects
    do, as of `responses`. sentence: what else there is to say. interrupted: not all was asked."""

    verdict: str
    causes: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    inclusion: Mapping[str, float]
    unknown: float
    slots: tuple[Slot, ...]
    base: Fit
    small: Sequence[np.ndarray]
    sentence: str = ""
    interrupted: bool = False

    @property
    def unsupported(self) -> Judgement:
        """Without causes: what they explain they do not predict."""
        if not self.causes:
            return self
        said = "What explains these trials best does not predict those left out of its fit."
        return replace(self, verdict="unknown", causes=(), groups=(), sentence=said)


def settled(
    found: Found, effects: Sequence[type[Effect]], criteria: Criteria, too_few_points: bool, seed: int
) -> tuple[Found, Judgement]:
    """Where no cause is another's look-alike beyond doubt, every effect a little wrong, and what is said there. After
    so many changes as there are causes, the last is not asked anew. too_few_points: the configured mesh alone puts the
    tip elsewhere."""
    for changes in range(len(found.fit.hypothesis.causes), -1, -1):
        small, slots, other = responses(found.prepared.data, found.fit, effects), list[Slot](), None
        names = found.fit.hypothesis.names
        for slot in _slots(found, effects, small, criteria, seed):
            slots.append(slot)
            credible = slot.credible(criteria.coverage)
            if names and (not credible[0] or not {*names} & {*credible}):  # none, or another cause beyond doubt
                other = other or slot.fits.get(credible[0], slot.less)
            if changes and other is not None:
                break
        if other is None:
            break
        found = found.instead(other)
    end = _with_likeliest(found, slots[::-1])
    if other is not None or end is not found:
        small = responses(end.prepared.data, end.fit, effects)
    return end, judged(end, small, slots[::-1], criteria, too_few_points, seed)


def _with_likeliest(found: Found, slots: Sequence[Slot]) -> Found:
    """With what is likeliest in the place of each cause, if that is more evident together than what entered."""
    fits = [slot.fits.get(slot.credible(0.0)[0]) for slot in slots]
    likeliest = {fit.hypothesis.causes[-1]: fit for fit in fits if fit is not None}
    causes, data = found.fit.hypothesis.causes, found.prepared.data
    if len(likeliest) != len(causes) or likeliest.keys() == {*causes}:
        return found
    known = {name: chi for fit in (found.fit, *likeliest.values()) for name, chi in fit.named.items()}
    together = Hypothesis(found.fit.hypothesis.base, tuple(likeliest))
    fit = fitted(data, together, together.carried(known)[None], found.fit.sizes)
    return max(found, found.instead(fit), key=lambda each: each.fit.evidence)


def interrupted(found: Found, effects: Sequence[type[Effect]], criteria: Criteria, seed: int) -> Judgement:
    """What a search that was interrupted knows: it names nothing before all was asked."""
    data, fit = found.prepared.data, found.fit
    small, often = responses(data, fit, effects), _bootstrap(len(data.trials), seed)
    last = {step.best.hypothesis.names[-1]: step for step in found.path if step.entered and step.best is not None}
    steps = (last[name] for name in fit.hypothesis.names if name in last)  # of what has not left again
    slots = tuple(_slot(data, step, small, often, len(effects), criteria.least_size) for step in steps)
    unnamed = _unnamed(found, small, slots, criteria, seed)
    likely = [f"{name} ({chance:.2f})" for name, chance in unnamed.inclusion.items() if chance > NOTHING]
    said = f"The search for causes was interrupted, when it had come to {', '.join(likely) or 'none'}."
    return replace(unnamed, verdict="insufficient", sentence=said, interrupted=True)


def _unnamed(
    found: Found, small: Sequence[np.ndarray], slots: Sequence[Slot], criteria: Criteria, seed: int
) -> Judgement:
    """Of the causes that entered, before any is named: `none`, or `unknown` where too much is left beside them."""
    data, fit = found.prepared.data, found.fit
    base = refitted(data, found.prepared.base, Hypothesis(fit.hypothesis.base)) if fit.hypothesis.causes else fit
    return _left(
        Judgement("none", (), (), _inclusion(slots), 0.0, tuple(slots), base, small), data, fit, criteria, seed
    )


def _left(unnamed: Judgement, data: Data, fit: Fit, criteria: Criteria, seed: int) -> Judgement:
    """The same by what a fit leaves."""
    unknown = left_over(data, fit, criteria, np.random.default_rng([seed, DRAWS]))
    return replace(unnamed, unknown=unknown, verdict="unknown" if unknown > 0.5 else "none")


def judged(
    found: Found,
    small: Sequence[np.ndarray],
    slots: Sequence[Slot],
    criteria: Criteria,
    too_few_points: bool,
    seed: int,
) -> Judgement:
    """The verdict on the causes that entered, one for each slot. small: as of `responses`."""
    data, fit, unnamed = found.prepared.data, found.fit, _unnamed(found, small, slots, criteria, seed)
    if fit.lost:
        said = "A trial cannot be simulated with the parameters that suit the others."
        return replace(unnamed, verdict="insufficient", sentence=said)
    left = unexplained(data, fit)
    together = removed(unexplained(data, unnamed.base), left, criteria.tolerance)
    least, largest, beside = criteria.least_share, "", 1.0
    if unnamed.verdict == "unknown":
        least, (largest, beside) = criteria.explained, _beside_largest(data, fit, left, criteria)
    if not fit.hypothesis.causes or together < least or beside < criteria.least_share:
        unnamed = unnamed if unnamed.base is fit else _left(unnamed, data, unnamed.base, criteria, seed)
        if unnamed.verdict == "none" and too_few_points:
            known = {**unnamed.inclusion, RESOLUTION: 1.0}
            return replace(unnamed, verdict="effect", causes=(RESOLUTION,), inclusion=known)
        nearest = _nearest(fit, together, largest, beside)
        return replace(unnamed, sentence=nearest if unnamed.verdict == "unknown" else "")
    groups = tuple(g for g in (_group(s, criteria) for s in slots) if len(g) > 1)
    causes = tuple(dict.fromkeys(name for slot in slots for name in _group(slot, criteria)))
    return replace(unnamed, verdict="ambiguous" if groups else "effect", causes=causes, groups=groups)


def _beside_largest(data: Data, fit: Fit, left: np.ndarray, criteria: Criteria) -> tuple[str, float]:
    """The cause without which most is lacking, and the share of what it alone leaves that the others remove: a large
    cause shall not carry what stands in for one that nobody knows. All of it where there are no others. left: what all
    of them leave in each trial [m], (K,)."""
    causes = fit.hypothesis.causes
    if len(causes) < 2:
        return "", 1.0
    without = [refitted(data, fit, fit.hypothesis.without(cause)) for cause in causes]
    number = int(np.argmax([np.mean(unexplained(data, less) ** 2) for less in without]))
    largest = causes[number]
    if len(causes) == 2:  # without the other
        alone = without[1 - number]
    else:
        alone = refitted(data, fit, Hypothesis(fit.hypothesis.base, (largest,)))
    return largest.name, removed(unexplained(data, alone), left, criteria.tolerance)


def _nearest(fit: Fit, together: float, largest: str, beside: float) -> str:
    """What comes nearest to an explanation, if anything does. together, beside: shares that the causes remove of what
    is lacking without them all, and with the largest alone."""
    names = fit.hypothesis.names
    if not names or together < 0:
        return ""
    said = f"What comes nearest, {' with '.join(names)}, removes {100 * together:.0f} % of it in mean square"
    if largest:
        others = " with ".join(name for name in names if name != largest)
        said += f", {others} {100 * max(beside, 0):.0f} % of what {largest} leaves"
    return f"{said}."


def left_over(data: Data, fit: Fit, criteria: Criteria, rng: np.random.Generator) -> float:
    """Probability that in some trial more is lacking at the tip than is tolerated, root mean square."""
    return float(np.mean(tip_draws(data, fit, rng).max(axis=0) > criteria.tolerance))


def _beside(found: Found, cause: type[Effect], effects: Sequence[type[Effect]], criteria: Criteria, seed: int) -> Step:
    """What else could be in the place of a cause, the others staying."""
    first = found.path[0]
    if first.best is not None and first.best.hypothesis.names == found.fit.hypothesis.names:
        return first
    data, less = found.prepared.data, found.fit.hypothesis.without(cause)
    itself = less.joined(cause)
    named = evaluated(data, itself, itself.carried(found.fit.named))
    return compared(found.prepared, refitted(data, found.fit, less), effects, criteria, seed, named)


def _slots(
    found: Found, effects: Sequence[type[Effect]], small: Sequence[np.ndarray], criteria: Criteria, seed: int
) -> Iterator[Slot]:
    """Of each cause, the last that entered first: it is most often another's look-alike. Of what might yet enter where
    none did."""
    data, causes = found.prepared.data, reversed(found.fit.hypothesis.causes)
    often = _bootstrap(len(data.trials), seed)
    steps = (_beside(found, cause, effects, criteria, seed) for cause in causes)
    for step in steps if found.fit.hypothesis.causes else found.path[-1:]:
        yield _slot(data, step, small, often, len(effects), criteria.least_size)


def _bootstrap(trials: int, seed: int) -> np.ndarray:
    """How often each trial counts in samples of those that might have been, (SAMPLES, K) (Bayesian bootstrap)."""
    return trials * np.random.default_rng([seed, SAMPLES]).dirichlet(np.ones(trials), SAMPLES)


def _slot(
    data: Data, step: Step, small: Sequence[np.ndarray], often: np.ndarray, count: int, least_size: float
) -> Slot:
    """Chances of what may be in one place of the sum, with all effects a little wrong, and trials that are a sample of
    those that might have been: each as often (D, K) as a Bayesian bootstrap has it (pseudo-BMA+: Yao et al. 2018,
    Bayesian Analysis 13, 917). Those fitted to the end alone, if any are. count: of candidates. least_size: [m] at the
    tip, below which an effect counts as none."""
    fits = {fit.hypothesis.names[-1]: fit for fit in step.to_the_end or step.tried if not fit.lost}
    prior = dict.fromkeys(fits, np.log((1 - NOTHING) / count)) | {"": np.log(NOTHING)}
    odds: dict[str, np.ndarray] = {
        name: fit.evidence + (often - 1) @ fit.by_trial + gains(data, fit, small, often) + prior[name]
        for name, fit in {"": step.parent, **fits}.items()
    }
    total = logsumexp(list(odds.values()), axis=0)
    chances = {name: float(np.mean(np.exp(value - total))) for name, value in odds.items()}
    for name, fit in fits.items():
        if moved(data, step.parent, fit).max() < least_size:
            chances[""] += chances.pop(name)
    return Slot(chances, fits, step.parent)


def _inclusion(slots: Sequence[Slot]) -> dict[str, float]:
    """Probability that each effect is in one place of the sum or another."""
    absent: dict[str, float] = {}
    for slot in slots:
        for name, chance in slot.chances.items():
            if name:
                absent[name] = absent.get(name, 1.0) * (1 - chance)
    return {name: 1 - share for name, share in absent.items()}


def _group(slot: Slot, criteria: Criteria) -> tuple[str, ...]:
    return tuple(name for name in slot.credible(criteria.coverage) if name)
