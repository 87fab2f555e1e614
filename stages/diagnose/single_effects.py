"""The search: one single effect after another, each chosen by its evidence beside those already at work.

A sum of single effects (SuSiE) is forward choice done as Bayes: for every effect in the sum all candidates compete,
none among them, and what cannot be told from the winner stays beside it. An effect enters that has evidence whichever
trial is left out of it (jackknife), and moves the tip; what entered earlier leaves again if what came later does
without, and what does not help to predict trials left out.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.diagnose.predictions import Prediction, predicted, rises
from stringcast.stages.diagnose.prepared import CLEARLY, FEWEST, SETTLED, Prepared, nearer, searched_again
from stringcast.stages.diagnose.proposals import Proposal, elsewhere, proposals
from stringcast.stages.inference.evidence import Fit, evaluated, fitted, lacked
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.effect import Effect, components, position_dependent

log = logging.getLogger(__name__)

PROMISING = 6  # proposals fitted first; the others, if none of these explains what is left
RIVALS = 3  # fitted to the end, at most

Share = Annotated[float, Field(gt=0, lt=1)]
Length = Annotated[float, Field(gt=0, lt=0.1)]


@dataclass(frozen=True)
class Criteria:
    """The seven numbers that decide. causes: at most. coverage: of credible sets and intervals. alpha: an effect enters
    with a Bayes factor of more than one over it. tolerance: [m] at the tip that may be left unexplained. least_size:
    [m] by which a cause must move the tip. least_share: of what is unexplained that the causes must remove; where they
    leave more than is tolerated, all but the largest of what that leaves. explained: the same there of all together."""

    causes: Annotated[int, Field(ge=1, le=8)]
    coverage: Share
    alpha: Share
    tolerance: Length
    least_size: Length
    least_share: Share
    explained: Share

    @property
    def enough(self) -> float:
        """Logarithm of the Bayes factor from which an effect enters."""
        return float(-np.log(self.alpha))


@dataclass(frozen=True)
class Step:
    """One choice. parent: the fit beside which it is made. proposals: of all candidates. tried: those fitted, the most
    evident first. to_the_end: those of them that came near to the most evident, and were fitted to the end. entered:
    whether the best of them is there beyond doubt."""

    parent: Fit
    proposals: Sequence[Proposal]
    tried: Sequence[Fit]
    to_the_end: Sequence[Fit] = ()
    entered: bool = False

    @property
    def best(self) -> Fit | None:
        """The most evident."""
        return self.tried[0] if self.tried else None

    def told_by(self, data: Data) -> Step:
        """The same of data with other points: those fitted to the end are so anew."""
        parent, *ended = (refitted(data, fit, fit.hypothesis) for fit in (self.parent, *self.to_the_end))
        others = [fit for fit in self.tried if not any(fit is other for other in self.to_the_end)]
        tried = _ranked([*ended, *(evaluated(data, fit.hypothesis, fit.chi) for fit in others)])
        return replace(self, parent=parent, tried=tried, to_the_end=ended)


@dataclass(frozen=True)
class Found:
    """Where a search ended. prepared: data about the last fit. fit: with all causes. path: what was chosen on the way,
    the last step being that which chose none."""

    prepared: Prepared
    fit: Fit
    path: Sequence[Step] = ()

    def instead(self, fit: Fit) -> Found:
        """With another fit, gone to its end."""
        return Found(*polished(self.prepared, fit), self.path)

    @cached_property
    def predictions(self) -> list[Prediction]:
        """Each trial by the fit to the others."""
        return predicted(self.prepared.data, self.fit)


def searched(
    prepared: Prepared, effects: Sequence[type[Effect]], criteria: Criteria, seed: int, starts: int
) -> Iterator[Found]:
    """With each of the causes that enter, one after another; in the end without those that do not help."""
    found = Found(prepared, prepared.base)
    for number in range(criteria.causes):
        step = compared(found.prepared, found.fit, effects, criteria, seed)
        found = replace(found, path=(*found.path, step))
        if step.best is None or not step.entered:
            break
        found = _joined(found, step.best, criteria, np.random.default_rng([seed, number]), starts)
        log.info(
            "enters: %s, evidence %+.1f", step.best.hypothesis.names[-1], step.best.evidence - step.parent.evidence
        )
        yield found
    yield pruned(found, criteria)


def pruned(found: Found, criteria: Criteria) -> Found:
    """Without causes that do not help to predict trials left out, the last that entered first.

    The log-likelihood of what was not seen must rise (cross-validation by trials: Vehtari, Gelman and Gabry 2017, Stat.
    Comput. 27, 1413), in the median trial: one that is foretold badly, such as a chaotic one 150 mm off by the
    right cause, would outvote all others. Of what acts in one trial alone no other trial can tell.
    """
    if len(found.prepared.data.trials) < 2:
        return found
    for cause in reversed(found.fit.hypothesis.causes):
        data = found.prepared.data
        if len(_touched(data, found.fit, cause, criteria.least_size)) == 1:
            continue
        less = replace(found, fit=refitted(data, found.fit, found.fit.hypothesis.without(cause)))
        gains = rises(less.predictions, found.predictions)
        log.info("without %s trials left out are %s likelier", cause.name, np.round(-gains, 1))
        if np.median(gains) <= 0:
            log.info("%s leaves: it does not help to predict trials left out", cause.name)
            found = found.instead(less.fit)
    return found


def compared(
    prepared: Prepared,
    parent: Fit,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    at_its_end: Fit | None = None,
) -> Step:
    """Every effect beside those of a fit, the promising ones fitted, and those like the best of them; all of them where
    something is to be explained and none of these does. Those that come near to the most evident are fitted to the end:
    little tells look-alikes. at_its_end: the fit of one of them, where that is known."""
    data, known = prepared.data, [] if at_its_end is None else [at_its_end]
    ranked = proposals(data, parent, [e for e in effects if e not in parent.hypothesis.causes], seed)
    rest = [p for p in ranked if not any(p.effect in fit.hypothesis.causes for fit in known)]
    first = [p for p in rest[:PROMISING] if p.gain > CLEARLY]
    step = Step(parent, ranked, _ranked([*known, *_fitted(prepared, parent, first)]))
    alike = _like_the_best(step, [p for p in rest if p not in first], criteria)
    step = replace(step, tried=_ranked([*step.tried, *_fitted(prepared, parent, alike)]))
    step = _contested(prepared, step, criteria, at_its_end)
    if not step.entered and unexplained(data, parent).max() > criteria.least_size:
        others = [p for p in rest if p not in first and p not in alike]
        step = replace(step, tried=_ranked([*step.tried, *_fitted(prepared, parent, others)]))
        step = _contested(prepared, step, criteria, at_its_end)
    return step


def _like_the_best(step: Step, others: Sequence[Proposal], criteria: Criteria) -> list[Proposal]:
    """Those of other proposals that could explain the least share of what the best does, to first order: promises may
    rank a look-alike lower."""
    if step.best is None or step.best.evidence < step.parent.evidence + criteria.enough:
        return []
    best = [p for p in step.proposals if p.effect is step.best.hypothesis.causes[-1]]
    return [p for p in others if any(p.like(each) ** 2 > criteria.least_share for each in best)]


def _contested(prepared: Prepared, step: Step, criteria: Criteria, at_its_end: Fit | None = None) -> Step:
    """With those fitted to the end that come near to the most evident, if that is evident at all, and whether the best
    then enters. Without one by which simulation tells fewer than two trials, or, in the place of a cause that is
    there, not all of them: what is in doubt in the others may explain anything."""
    parent = step.parent
    if step.best is None or step.best.evidence < parent.evidence + criteria.enough:
        return step
    near = parent.evidence + criteria.least_share * (step.best.evidence - parent.evidence)
    count = sum(fit.evidence > near for fit in step.tried[:RIVALS])
    rivals = [(prepared, fit) if fit is at_its_end else polished(prepared, fit) for fit in step.tried[:count]]
    enough, least = len(prepared.doubt), np.zeros(len(prepared.doubt))
    if at_its_end is None:
        enough, least = min(FEWEST, enough), np.sqrt(1 - criteria.explained) * unexplained(prepared.data, parent)
    told = [fit for made, fit in rivals if _told(made, prepared, criteria, least) >= enough]
    step = replace(step, tried=_ranked([*told, *step.tried[count:]]), to_the_end=told)
    return replace(step, entered=step.best is not None and enters(prepared.data, step, criteria))


def _told(made: Prepared, before: Prepared, criteria: Criteria, least: np.ndarray | float = 0.0) -> int:
    """How many trials simulation tells to the tolerance, or as well as the worst of them before, or to what may be left
    of what is to be explained in each [m], (K,)."""
    return int((made.doubt <= np.maximum(max(before.doubt.max(), criteria.tolerance), least)).sum())


def enters(data: Data, step: Step, criteria: Criteria) -> bool:
    """Whether the best of a step is there beyond doubt: without any one trial, and large enough to matter.

    What touches the string in one trial alone, all the others cannot say: it must explain that one.
    """
    best = step.best
    assert best is not None
    gain = best.evidence - step.parent.evidence
    if gain < criteria.enough or best.lost or moved(data, step.parent, best).max() < criteria.least_size:
        return False
    touched = _touched(data, best, best.hypothesis.causes[-1], criteria.least_size)
    if len(touched) == 1:
        parts = shares(unexplained(data, step.parent), unexplained(data, best))
        return bool(parts[touched[0]] > criteria.least_share)
    if len(data.trials) == 1:  # which nothing could confirm: it is only said what would be asked of more trials
        return True
    return (
        least_gain(step.parent, best) > criteria.enough
        or _gain_anew(data, step) > criteria.enough
        or _gain_foretold(data, step) > criteria.enough
    )


def least_gain(parent: Fit, fit: Fit) -> float:
    """Gain of the evidence, whichever trial is left out, both fits staying where they are."""
    return float(fit.evidence - parent.evidence - (fit.by_trial - parent.by_trial).max())


def _gain_anew(data: Data, step: Step) -> float:
    """Gain of the evidence without the trial that says most for the best of a step, fitted anew to the others: that one
    may have taken the fit along."""
    best = step.best
    assert best is not None
    most = int(np.argmax(best.by_trial - step.parent.by_trial))
    rest = [k for k in range(len(data.trials)) if k != most]
    if not rest:
        return -np.inf
    fits = (best, step.parent)
    others = [fitted(data.only(rest), f.hypothesis, f.chi[None], f.sizes[rest]) for f in fits]
    return others[0].evidence - others[1].evidence


def _gain_foretold(data: Data, step: Step) -> float:
    """Gain of the log-likelihood of trials, each foretold by the fit to the others, but for the one that gains most: a
    parent may explain one trial at the cost of another, which alone then speaks for what explains both."""
    assert step.best is not None
    gains = rises(predicted(data, step.parent), predicted(data, step.best))
    return float(gains.sum() - gains.max())


def _touched(data: Data, fit: Fit, cause: type[Effect], least_size: float) -> np.ndarray:
    """Numbers of the trials in which a cause of a fit that depends on place moves the tip by that much [m]."""
    if not position_dependent(cause):
        return np.zeros(0, dtype=int)
    sizes = {cause.qualified(parameter) for parameter in components(cause)}
    absent = fit.hypothesis.carried({name: chi for name, chi in fit.named.items() if name not in sizes})
    others = [each[0] for each in data.residuals(fit.hypothesis.model, absent[None])]
    acts = data.tip_rms([a - b for a, b in zip(fit.residuals, others, strict=True)])
    return np.flatnonzero(acts > least_size)


def unexplained(data: Data, fit: Fit) -> np.ndarray:
    """Root mean square at the tip of what a fit most likely lacks in each trial [m], (K,)."""
    return data.tip_rms(lacked(data, fit))


def removed(before: np.ndarray, after: np.ndarray, tolerance: float) -> float:
    """Share of what one fit lacks in each trial [m], (K,), as of `unexplained`, that another does not: the mean of the
    trials in which either lacks more than is tolerated [m], one vote each, for one that is far off says nothing of the
    others, nor do they of it."""
    lacking = np.maximum(before, after)
    return float(shares(before, after)[lacking >= min(tolerance, lacking.max())].mean())


def shares(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """By how much less a fit lacks in each trial than another [m], (K,) each, in mean square at the tip, over the
    larger of both, (K,): 1 where it lacks nothing, -1 where the other does not."""
    before, after = before**2, after**2
    return np.asarray((before - after) / np.maximum(np.maximum(before, after), np.finfo(float).tiny))


def moved(data: Data, one: Fit, other: Fit) -> np.ndarray:
    """Root mean square by which two fits differ at the tip of each trial [m], (K,)."""
    return data.tip_rms([a - b for a, b in zip(one.residuals, other.residuals, strict=True)])


def polished(prepared: Prepared, fit: Fit) -> tuple[Prepared, Fit]:
    """Data with the numerical error of a fit, and the fit to these: with other values of its causes' parameters, if
    these suit better."""
    log.info("to the end: %s", " + ".join(fit.hypothesis.names))
    prepared, fit = nearer(prepared, fit)
    others = elsewhere(prepared.data, fit)
    if not len(others):
        return prepared, fit
    other = fitted(prepared.data, fit.hypothesis, others, fit.sizes)
    return nearer(prepared, other) if other.evidence > fit.evidence else (prepared, fit)


def _joined(found: Found, best: Fit, criteria: Criteria, rng: np.random.Generator, starts: int) -> Found:
    """With one more cause, numerical error as it is there, and without causes that are not needed any more. Other
    strings are no better whose trials cannot be simulated as well: what is in doubt of these may explain anything."""
    heard = found.prepared.heard(best)
    prepared, fit = nearer(heard, best)
    if heard.counts != found.prepared.counts:
        log.info("%d outliers instead of %d", heard.outliers, found.prepared.outliers)
        found = replace(found, path=[step.told_by(prepared.data) for step in found.path])
    if unexplained(prepared.data, fit).max() > criteria.least_size:
        again = polished(prepared, searched_again(prepared.data, fit, rng, starts))
        if again[1].evidence > fit.evidence and _told(again[0], prepared, criteria) == len(prepared.doubt):
            prepared, fit = again
    joined = Found(prepared, fit, found.path)
    for cause in best.hypothesis.causes:  # the new one, too: where it led, the others may do without it
        less = refitted(joined.prepared.data, joined.fit, joined.fit.hypothesis.without(cause))
        if less.evidence > joined.fit.evidence - criteria.enough:
            log.info("%s leaves: it is not needed", cause.name)
            joined = joined.instead(less)
    return joined


def refitted(data: Data, fit: Fit, hypothesis: Hypothesis) -> Fit:
    """Another hypothesis at its best, from where a fit is."""
    return fitted(data, hypothesis, hypothesis.carried(fit.named)[None], fit.sizes)


def _fitted(prepared: Prepared, parent: Fit, some: Sequence[Proposal]) -> list[Fit]:
    """Proposals fitted, those that gain with their own numerical error: a strip in a clamp gained 128 without that, and
    637 with."""
    fits: list[Fit] = []
    for number, proposal in enumerate(some, 1):
        best = max((fit.evidence for fit in fits), default=parent.evidence) - parent.evidence
        log.info("%d of %d: %s, best %+.1f", number, len(some), proposal.effect.name, best)
        fit = fitted(prepared.data, proposal.hypothesis, proposal.starts, parent.sizes, SETTLED)
        first = fit.evidence - parent.evidence
        if first > 0:
            fit = fitted(prepared.told_by(fit), fit.hypothesis, fit.chi[None], fit.sizes, SETTLED)
        gains = (fit.evidence - parent.evidence, first, proposal.gain)
        log.info("%s: evidence %+.1f, at first %+.1f, promised %.1f", proposal.effect.name, *gains)
        fits.append(fit)
    return _ranked(fits)


def _ranked(fits: Sequence[Fit]) -> list[Fit]:
    return sorted(fits, key=lambda fit: -fit.evidence)
