"""The choice of causes: forwards while one earns its place on trials not seen, then backwards and across."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.diagnose.closing import closer
from stringcast.stages.diagnose.compare import blocks, moved
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.hypotheses import INEXACT, Causes, Hypotheses
from stringcast.stages.diagnose.intervals import present
from stringcast.stages.diagnose.noise import CLEAR, visible, visible_in_each
from stringcast.stages.model.effect import placed

log = logging.getLogger(__name__)

MOST_CAUSES = 3
SUSPECT = -0.9  # logarithm of a mismatch from which causes are looked for: without any it is -1.6 to -1.0
MATTERS = 2.5  # standard deviations by which a cause must move something somewhere
PENALTY = 5.0  # of the log-likelihood for each parameter that was not asked of other trials
FEW = 2  # trials, which a cause may fit though it is wrong
MAINLY = 0.4  # of where it moves most: a trial moved less can say little of a cause
NEARLY, FOLLOWED = 0.75, 2  # share of what the best explains alone, and how many that explain so much are followed
CONFIRMED = 0.5  # share of what a cause explains where it is fitted that it must explain where it is not
AGAINST = 2  # sets of causes that are fitted once more against those that were chosen
GAIN = 8.0  # least gain of the log-likelihood on trials not seen, in units of its own noise


def chosen(hypotheses: Hypotheses, progress: Progress, begin: Causes = frozenset()) -> tuple[Hypotheses, Causes]:
    """The causes that earn their place: added one by one, then each tried again without and replaced by others.

    Also what was tried in the end: where a cause moves the string elsewhere, the simulation's doubt is found anew.
    begin: causes that have earned theirs.
    """
    best = begin
    before: set[Causes] = set()  # two that do each other's work could replace each other for ever
    while len(best) < MOST_CAUSES and best not in before and _suspect(hypotheses, best):
        before.add(best)
        step = next((step for step in _steps(hypotheses, best) if earns(hypotheses, best, step[1])), None)
        if step is None:
            break
        log.info("%s: %s enters", _listed(best), _listed(step[1] - best))
        best = _needed(hypotheses, _settled(hypotheses, *step), bool)  # alone, it has just earned its place
        hypotheses = hypotheses.renewed(best)
        for name in sorted(best):
            if placed(hypotheses.library[name]):
                hypotheses.add(closer(hypotheses.evidence, hypotheses.tried[best], hypotheses.library[name]))
        best = _needed(hypotheses, best, hypotheses.explained)  # more mass points or another doubt may do its work
        log.info("%s stands", _listed(best))
        progress(len(best) / MOST_CAUSES)
    progress(1.0)
    return hypotheses, best


def _listed(causes: Causes) -> str:
    return " + ".join(sorted(causes)) or "the base model"


def _suspect(hypotheses: Hypotheses, causes: Causes) -> bool:
    """Whether something may be there beside causes: a graze is seen for a few frames, and nowhere else."""
    shown = hypotheses.mismatch(causes) > SUSPECT
    return shown or visible(hypotheses.evidence, hypotheses.tried[causes].residual) > CLEAR


def _steps(hypotheses: Hypotheses, causes: Causes) -> Iterator[tuple[Causes, Causes]]:
    """What may be added, one after the other: the causes to which the last one is added, and all of them.

    What explains most may predict nothing where its look-alike, which explains nearly as much, does.
    """
    first = _added(hypotheses, causes)
    yield causes, first
    asked = {first}
    if len(causes) + 2 <= MOST_CAUSES:
        for step in _two_steps(hypotheses, causes, first):
            asked.add(step[1])
            yield step
    for name in _likely(hypotheses, causes):
        if causes | {name} not in asked:
            yield causes, causes | {name}


def _two_steps(hypotheses: Hypotheses, causes: Causes, first: Causes) -> Iterator[tuple[Causes, Causes]]:
    """Two that may be added: of two that are needed, one alone may predict nothing. Then each that was not asked alone:
    of two that were added, one may only have led to the other. first: what was asked alone."""
    fewer, both = _two_added(hypotheses, causes)
    yield fewer, both
    for name in sorted(both - first):
        hypotheses.fit(causes | {name}, both)
        hypotheses.level([causes | {name}], both)
        yield causes, causes | {name}


def _added(hypotheses: Hypotheses, causes: Causes) -> Causes:
    """With the one cause more that fits best; as they are where there is none."""
    fits = hypotheses.extended(causes)
    return causes | {min(fits, key=lambda name: fits[name].cost)} if fits else causes


def _two_added(hypotheses: Hypotheses, causes: Causes) -> tuple[Causes, Causes]:
    """With the one cause more from which a second leads to the best fit, and with both.

    What explains most alone may do some of the work of two: what explains nearly as much is followed as well.
    """
    likely = _likely(hypotheses, causes)[:FOLLOWED]
    pairs = [(causes | {name}, _added(hypotheses, causes | {name})) for name in likely]
    return min(pairs, key=lambda pair: hypotheses.tried[pair[1]].cost, default=(causes, causes))


def _likely(hypotheses: Hypotheses, causes: Causes) -> list[str]:
    """Each cause that explains nearly as much beside these as the one that explains most, best first."""
    plain = hypotheses.tried[causes].cost
    gains = {name: plain - fit.cost for name, fit in hypotheses.extended(causes).items()}
    least = NEARLY * max(gains.values(), default=0.0)
    return [name for name in sorted(gains, key=gains.__getitem__, reverse=True) if gains[name] > least]


def _settled(hypotheses: Hypotheses, before: Causes, best: Causes) -> Causes:
    """With causes that were there before the last one replaced, where others do better in their place."""
    for cause in (name for name in hypotheses.tried[best].theory.names if name in before):
        context = best - {cause}
        hypotheses.fit(context, best)
        other = _added(hypotheses, context)
        better = _priced(hypotheses, other) < _priced(hypotheses, best)
        best = other if better and earns(hypotheses, context, other) else best
    return best


def _needed(hypotheses: Hypotheses, best: Causes, asked: Callable[[Causes], bool]) -> Causes:
    """Without causes that no longer earn their place beside the others. asked: whether these could do alone."""
    for cause in sorted(best):
        without = best - {cause}
        hypotheses.fit(without, best)
        if asked(without) and not earns(hypotheses, without, best):
            best = without
    return best


def levelled(hypotheses: Hypotheses, causes: Causes) -> Causes:
    """These causes, or the best of as many that stand against them if that is better, after the two best of those were
    fitted from where these put the string, too: a fit that stopped short is no worse theory."""
    others = [key for key in hypotheses.tried if len(key) == len(causes) and key != causes]
    against = sorted(others, key=lambda key: hypotheses.tried[key].cost)[:AGAINST]
    hypotheses.level(against, causes)
    best = min([causes, *against], key=lambda key: _priced(hypotheses, key))
    if best == causes:
        return causes
    hypotheses.level([causes], best)
    hypotheses.fit(causes & best, best)
    if _priced(hypotheses, best) >= _priced(hypotheses, causes) or not earns(hypotheses, causes & best, best):
        return causes
    return _needed(hypotheses, best, bool)


def _priced(hypotheses: Hypotheses, causes: Causes) -> float:
    """Cost of a fit, and of its parameters."""
    fit = hypotheses.tried[causes]
    return fit.cost + PENALTY * len(fit.theory.free)


def earns(hypotheses: Hypotheses, without: Causes, causes: Causes) -> bool:
    """Whether causes move something by enough to matter, cannot be absent, and predict trials not fitted to.

    Of one that acts in a single trial no other trial can say anything, and of a place that several reach the others
    say too little: these must explain all trials in which they act to the noise, or foretell them after all. But where
    all that there is are two trials, and it acts in both, nothing would have been asked of it.
    """
    hypotheses.refitted(without, causes)
    plain, fit = hypotheses.tried[without], hypotheses.tried[causes]
    acts = moved(hypotheses.evidence, plain, fit)
    new = [hypotheses.library[name] for name in causes - without]
    if acts.max() < MATTERS or not present(hypotheses.evidence, fit, new):
        return False
    explained = hypotheses.tried[frozenset()].cost - fit.cost
    least = max(GAIN * noisiness(hypotheses.evidence, fit), hypotheses.by_chance(causes), INEXACT * explained)
    there = acts > max(MATTERS, MAINLY * acts.max())
    local = there.sum() == 1 or all(placed(effect) for effect in new)
    checked = not there.all() or len(there) > FEW
    if local and checked and _explains(hypotheses.evidence, fit, there):
        price = PENALTY * (len(fit.theory.free) - len(plain.theory.free))
        return plain.cost - fit.cost > least + price
    if len(acts) == 1:
        return False
    return hypotheses.foretells(without, causes) > max(least, CONFIRMED * (plain.cost - fit.cost))


def _explains(evidence: Evidence, fit: Fit, there: np.ndarray) -> bool:
    """Whether nothing is left to be seen in some trials, (K,)."""
    return bool((visible_in_each(evidence, fit.residual)[there] < CLEAR).all())


def noisiness(evidence: Evidence, fit: Fit) -> float:
    """Variance of what the residual has by chance along a smooth direction, over that of white noise.

    From sums over pieces of time along the directions of the fit's own slopes.
    """
    piece = blocks(evidence)
    count = piece.max() + 1
    directions, _ = np.linalg.qr(fit.slopes)
    sums = np.stack([np.bincount(piece, column * fit.residual, count) for column in directions.T])
    return max(float(np.mean((sums**2).sum(axis=1))), 1.0)
