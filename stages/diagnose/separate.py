"""The motion that would tell look-alikes apart: out of many random ones, that on which they differ most beyond what
each could explain by moving its own parameters as far as the trials made allow.

First all motions with the theories as they were fitted, then the promising ones with all that their parameters can
do to first order; the best of these are rehearsed, with every theory really fitted, and of the best few of them it is
asked what chance makes of it. What is counted is the log odds that the diagnosis itself would find.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data.artifacts import FORETOLD
from stringcast.stages.diagnose.casts import Design, imagined, possible, standing_for
from stringcast.stages.diagnose.choose import noisiness
from stringcast.stages.diagnose.evidence import LOST, Evidence
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.foretell import DECIDED, Outlook, Prospect, Rehearsal, again
from stringcast.stages.diagnose.hypotheses import Causes, Hypotheses, carried
from stringcast.stages.diagnose.resolve import SEGMENTS, finer
from stringcast.stages.diagnose.single_effects.design import Proposal, without_motion
from stringcast.stages.diagnose.verdict import Judgement
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.generate import commands_of, control_points_of
from stringcast.stages.inference.forward import Case
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.parameter import values_of

RIVAL = 0.02  # of the likeliest: sets of causes at least as likely are worth an experiment
TOGETHER = 16  # motions simulated at once
PROMISING = 48  # motions of which all that the theories could do is simulated
REHEARSED = 8, 16  # of these, at most, with which the theories are really fitted: more while none tells anything
STEPS = 8  # of these fits
BEST = 3  # of these, of which chance is drawn
DRAWS = 100
TELLS = 1.0  # log odds that a motion must be expected to give, or it tells nothing


@dataclass(frozen=True)
class Contest:
    """Theories that stand against one another. names: of what differs in them. chances: that each is right, summing to
    one. base: the base model's fit. evidence: the trials made."""

    names: tuple[str, ...]
    fits: tuple[Fit, ...]
    chances: np.ndarray
    base: Fit
    evidence: Evidence

    @cached_property
    def chance(self) -> float:
        """By how much noise counts for more than if it were white."""
        return noisiness(self.evidence, self.likeliest)

    @property
    def rough(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Numbers of segments that are good enough to look at many motions, and those by which their error is told."""
        some = self.evidence.segments
        return (SEGMENTS[0], SEGMENTS[1]) if len(some) > 1 else (some, some)

    @property
    def likeliest(self) -> Fit:
        """The fit that is right if any has to be."""
        return self.fits[int(np.argmax(self.chances))]

    def prospects(self, new: Evidence) -> list[Prospect]:
        """What each of some new trials would say."""
        every = (*self.fits, self.base)
        seen = fitted(new, [fit.theory for fit in every], [fit.chi for fit in every], 0)
        return [self._prospect([again(f, new.trial, k) for f in seen], new.only([k])) for k in range(len(new.cases))]

    def rehearsed(self, new: Evidence) -> list[Rehearsal]:
        """What one new trial would say, whichever theory is right."""
        every = (*self.fits, self.base)
        theories, starts = [fit.theory for fit in every], [fit.chi for fit in every]
        made = []
        for true, seen in enumerate(fitted(new, theories[:-1], starts[:-1], 0)):
            shown = replace(new.cases[0], points=(seen.residual * new.sigma).reshape(-1, 2))
            evidence = replace(new, cases=(*self.evidence.cases, shown), unsure=self._unsure(shown))
            there = carried(self.base.theory, self.fits[true])  # where the string is, the base model may be nearer
            *fits, base, near = fitted(evidence, [*theories, self.base.theory], [*starts, there], STEPS)
            base = min(base, near, key=lambda fit: fit.cost)
            made.append(Rehearsal(true, Outlook(self.fits[true], seen), fits, base, evidence, self.chance))
        return made

    def _unsure(self, shown: Case) -> tuple[np.ndarray, ...]:
        """Of the trials made, and of one that begins at rest."""
        return (*self.evidence.unsure, np.empty((2 * len(shown.s), 0))) if self.evidence.unsure else ()

    def performed(self) -> list[Prospect]:
        """The same if a trial were made once more."""
        return [
            self._prospect([again(f, self.evidence.trial, k) for f in (*self.fits, self.base)], self.evidence.only([k]))
            for k in range(len(self.evidence.cases))
        ]

    def _prospect(self, seen: Sequence[Fit], new: Evidence) -> Prospect:
        *rivals, base = (Outlook(p, n) for p, n in zip((*self.fits, self.base), seen, strict=True))
        return Prospect(rivals, base, self.evidence, new, self.chance)


@dataclass(frozen=True)
class Forecast:
    """What a motion is expected to do. probability: that the log odds of the true theory over the others exceed those
    at which the data decide. odds: the least of these log odds, on average; spread: its standard deviation."""

    probability: float
    odds: float
    spread: float

    def stated(self) -> dict[str, float]:
        """As it stands in diagnosis.json."""
        numbers = {"probability_to_decide": self.probability, "expected_log_odds": self.odds, "spread": self.spread}
        return {name: round(value, 3) for name, value in numbers.items()}


def contest(hypotheses: Hypotheses, judgement: Judgement) -> Contest | None:
    """The theories that could each be right, in the order of their names, or None where there is but one."""
    chances = judgement.chances
    keys = [key for key in chances if chances[key] > RIVAL * max(chances.values())]
    if judgement.verdict not in ("effect", "ambiguous") or len(keys) < 2:
        return None
    shared: Causes = frozenset.intersection(*keys)
    named = sorted((" + ".join(sorted(key - shared)), key) for key in keys)
    share = np.array([chances[key] for _, key in named])
    fits = tuple(hypotheses.tried[key] for _, key in named)
    return Contest(
        tuple(n for n, _ in named), fits, share / share.sum(), hypotheses.tried[frozenset()], hypotheses.evidence
    )


def separated(
    hypotheses: Hypotheses, judgement: Judgement, obstacles: Sequence[Box], design: Design, rng: np.random.Generator
) -> Proposal:
    """The motion to perform next, and what it will do; nothing where one theory stands alone or the arm is unknown."""
    rivals = contest(hypotheses, judgement)
    if rivals is None or not all(isinstance(case.motion, JointMotion) for case in hypotheses.evidence.cases):
        return without_motion(None)
    curves = possible(hypotheses.base, obstacles, design, rng)
    if not len(curves.duration):
        return without_motion(None)
    return proposed(rivals, hypotheses.floor, curves, obstacles, design, rng)


def proposed(
    rivals: Contest,
    floor: Evidence,
    curves: Curves,
    obstacles: Sequence[Box],
    design: Design,
    rng: np.random.Generator,
) -> Proposal:
    """The best of some motions. floor: the trials made, with noise alone."""
    like = max(floor.cases, key=lambda case: len(case.s))
    model = rivals.likeliest.theory.model
    cases = [imagined(model, curves.only(np.array([i])), like, design) for i in range(len(curves.duration))]
    few = promising(rivals, cases, like, obstacles)
    if not few:
        return without_motion(None)
    made = _rehearsed(rivals, cases, like, few)
    apart = {i: _apart(each) for i, each in made.items()}
    pairs = np.max(list(apart.values()), axis=0) > TELLS
    asked = _asked(pairs)
    best = sorted(made, key=lambda i: _least(apart[i], asked), reverse=True)[:BEST]
    found = {i: forecast(rivals, np.stack([one.drawn(DRAWS, rng) for one in made[i]]), asked) for i in best}
    first = max(best, key=lambda i: (round(found[i].probability, 2), found[i].odds))
    text = _document(rivals, pairs, asked, found[first], _performed(rivals, asked, rng), len(cases))
    if not pairs.any():
        return without_motion(text)
    curve = curves.only(np.array([first]))
    seen = foretold(rivals, made[first])
    return Proposal(text, commands_of(model.arm, curve), control_points_of(curve), seen)


def promising(rivals: Contest, cases: Sequence[Case], like: Case, obstacles: Sequence[Box]) -> list[int]:
    """The motions on which the theories differ most as they were fitted: on no other can they differ much.

    Not those on which a simulation fails, or the string would touch an obstacle.
    """
    every = trusted(rivals, cases, like, *rivals.rough)
    seen = [every.residuals(fit.theory.model, fit.chi[None])[0] for fit in rivals.fits]
    apart = np.min([np.bincount(every.trial, (a - b) ** 2) for a, b in combinations(seen, 2)], axis=0)
    failed = np.bincount(every.trial, np.any(np.array(seen) == LOST, axis=0)) > 0
    struck = np.array([_touches(rivals.likeliest, case, obstacles) for case in cases])
    allowed = np.flatnonzero(~failed & ~struck)
    return [int(i) for i in allowed[np.argsort(-apart[allowed], kind="stable")][:PROMISING]]


def _touches(fit: Fit, case: Case, obstacles: Sequence[Box]) -> bool:
    """Whether the string is ever in an obstacle: all of it, wherever it would be measured."""
    if not obstacles:
        return False
    model = fit.theory.model.divided(SEGMENTS[0][0])
    line = model.true(case.motion, values_of(model.parameters, fit.chi[None]), case.times, case.initial).points[0]
    return any(bool(box.crossed(line[:, :-1], line[:, 1:]).any()) for box in obstacles)


def _first(rivals: Contest, cases: Sequence[Case], like: Case, some: Sequence[int]) -> list[Prospect]:
    """What some motions would say, by few mass points."""
    return rivals.prospects(trusted(rivals, [cases[i] for i in some], like, *rivals.rough))


def trusted(
    rivals: Contest, cases: Sequence[Case], like: Case, segments: tuple[int, ...], finer: tuple[int, ...]
) -> Evidence:
    """Imagined trials with noise and the simulation's own error as sigma, each point as certain as those it stands
    for."""
    fit = rivals.likeliest
    doubted = Evidence(tuple(cases), segments).doubted(fit.theory.model, fit.chi, finer)
    many = [standing_for(fit.theory.model, case, like) for case in cases]
    weighted = [replace(c, sigma=c.sigma / np.sqrt(m)) for c, m in zip(doubted.cases, many, strict=True)]
    return replace(doubted, cases=tuple(weighted))


def _rehearsed(
    rivals: Contest, cases: Sequence[Case], like: Case, few: Sequence[int]
) -> dict[int, Sequence[Rehearsal]]:
    """The motions that to first order tell most, rehearsed until none is left that promises more than was found."""
    parts = [few[k : k + TOGETHER] for k in range(0, len(few), TOGETHER)]
    told = [_each_way(prospect.expected()) for part in parts for prospect in _first(rivals, cases, like, part)]
    asked = _asked(np.max(told, axis=0) > TELLS)
    promise = np.array([_least(each, asked) for each in told])
    made: dict[int, Sequence[Rehearsal]] = {}
    reached = -np.inf
    for place in np.argsort(-promise, kind="stable")[: REHEARSED[1]]:
        if promise[place] <= reached or (len(made) >= REHEARSED[0] and reached > TELLS):
            break
        some = rivals.evidence.segments
        each = rivals.rehearsed(trusted(rivals, [cases[few[place]]], like, some, finer(some)))
        made[few[place]] = each
        reached = max(reached, _least(_apart(each), asked))
    return made


def _apart(made: Sequence[Rehearsal]) -> np.ndarray:
    """Log odds (R, R) that a rehearsed motion gives between two theories, whichever of them is true."""
    return _each_way(np.stack([one.expected() for one in made]))


def _each_way(odds: np.ndarray) -> np.ndarray:
    """Log odds (R, R) that a motion gives between two theories, whichever of them is true."""
    return np.minimum(odds, odds.T)


def _asked(pairs: np.ndarray) -> np.ndarray:
    """Between which theories, (R, R), a motion is to decide: those that can be told apart, or else all."""
    return pairs if pairs.any() else ~np.eye(len(pairs), dtype=bool)


def _least(odds: np.ndarray, asked: np.ndarray) -> float:
    """The least over pairs of theories that are asked of. odds, asked: (R, R)."""
    return float(np.where(asked, odds, np.inf).min())


def forecast(rivals: Contest, odds: np.ndarray, asked: np.ndarray) -> Forecast:
    """What a motion does with chance at work. odds: (R, R, draws) of each theory, if it is true, over each other.
    asked: (R, R) between which it is to decide."""
    worst = np.where(asked[..., None], odds, np.inf).min(axis=1)[asked.any(axis=1)]
    share = rivals.chances[asked.any(axis=1)]
    share = np.repeat(share / share.sum() / odds.shape[-1], odds.shape[-1])
    mean = float(share @ worst.ravel())
    spread = float(np.sqrt(share @ (worst.ravel() - mean) ** 2))
    return Forecast(float(share @ (worst.ravel() > DECIDED)), mean, spread)


def _performed(rivals: Contest, asked: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """The same of the best trial made, if it were made once more."""
    prospects = rivals.performed()
    best = int(np.argmax([_least(_each_way(prospect.expected()), asked) for prospect in prospects]))
    said = forecast(rivals, prospects[best].drawn(DRAWS, rng), asked).stated()
    return {"trial": rivals.evidence.cases[best].name, **said}


def foretold(rivals: Contest, made: Sequence[Rehearsal]) -> pd.DataFrame:
    """Table FORETOLD: the string under the likeliest theory, and as near to that as each other can come."""
    first = int(np.argmax(rivals.chances))
    order = [first, *(i for i in range(len(rivals.names)) if i != first)]
    case, expected = made[first].evidence.cases[-1], made[first].right.expected[:, 0]
    frames = []
    for i in order:
        off = expected if i == first else expected + made[first].fits[i].residual[-len(expected) :]
        x, y = (off.reshape(-1, 2) * case.sigma[:, None]).T
        table = {"theory": rivals.names[i], "t": case.times[case.frame], "s": case.s, "x": x, "y": y}
        frames.append(pd.DataFrame(table | {"sigma": case.sigma}))
    return FORETOLD.check(pd.concat(frames, ignore_index=True))


def _document(
    rivals: Contest, pairs: np.ndarray, asked: np.ndarray, found: Forecast, old: Mapping[str, Any], count: int
) -> dict[str, Any]:
    """next_experiment, but for the place where the motion will be."""
    alike = [[rivals.names[i], rivals.names[j]] for i, j in combinations(range(len(pairs)), 2) if not pairs[i, j]]
    between = [name for i, name in enumerate(rivals.names) if asked[i].any()]
    text = {"sentence": _sentence(between, alike, found, old, count, bool(pairs.any())), "between": between}
    return text | found.stated() | {"already_performed": old, "inseparable": alike, "motions_compared": count}


def _sentence(
    between: Sequence[str],
    alike: Sequence[Sequence[str]],
    found: Forecast,
    old: Mapping[str, Any],
    count: int,
    helps: bool,
) -> str:
    pairs = "; ".join(" and ".join(pair) for pair in alike)
    if not helps:
        return f"No motion tells them apart, of {count} within the arm's limits: {pairs}."
    told = (
        f"Of {count} motions within the arm's limits, one tells {', '.join(between)} apart with a probability of "
        f"{found.probability:.2f} (expected log odds {found.odds:.1f}, spread {found.spread:.1f}; {DECIDED:.1f} "
        f"decides). Trial {old['trial']} made once more would with {old['probability_to_decide']:.2f}."
    )
    return told + (f" None of them tells apart: {pairs}." if alike else "")
