"""The choice of causes: forwards while one earns its place on trials not seen, then backwards and across."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stages.diagnose.beginning import begun, doubted_beginnings
from stages.diagnose.chance import by_chance
from stages.diagnose.closing import PROBES, closed_in, closer
from stages.diagnose.compare import HeldOut, blocks, held_out, moved
from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import Fit, fitted, ranked
from stages.diagnose.intervals import present
from stages.diagnose.noise import CLEAR, mismatch, visible
from stages.diagnose.resolve import refined
from stages.diagnose.screen import Probe, screened, spread
from stages.diagnose.theory import Theory, candidates, joined
from stages.model.effect import Effect, placed
from stages.model.model import Model
from stages.progress import Progress

Causes = frozenset[str]

MOST_CAUSES = 3
FIRST = 2  # steps of every promising effect's fit
AGAIN = 4  # of a fit where doubt was found anew
SHORTLIST = 6  # fits that then go on
STARTS = 2  # probes of each from which it is fitted
PROMISING = 5.0  # of a predicted gain of the log-likelihood
UNDERRATED = 3.0  # times what first order says of an effect that depends on place, it may gain
STEPS = 14
LEVEL = 0.01  # of a cost, by which another fit of the same causes must be better to count
SUSPECT = -0.5  # logarithm of a mismatch from which causes are looked for, though nothing need be there
MATTERS = 2.5  # standard deviations by which a cause must move something somewhere
PENALTY = 5.0  # of the log-likelihood for each parameter that no other trial confirms
MAINLY = 0.4  # of where it moves most: a trial moved less can say little of a cause
INEXACT = 0.002  # share of what a right model explains by which it may be wrong, and no cause be behind it
CONFIRMED = 0.5  # share of what a cause explains where it is fitted that it must explain where it is not
GAIN = 8.0  # least gain of the log-likelihood on trials not seen, in units of its own noise


@dataclass
class Court:
    """What has been tried so far on this evidence: each set of causes is fitted once.

    evidence: with the simulation's doubt; first: as it was before there was a cause; floor: with noise alone.
    """

    evidence: Evidence
    first: Evidence
    floor: Evidence
    base: Model
    library: Mapping[str, type[Effect]]
    seed: int
    tried: dict[Causes, Fit] = field(default_factory=dict)
    contexts: dict[Causes, dict[str, Fit]] = field(default_factory=dict)
    probes: dict[Causes, dict[str, list[Probe]]] = field(default_factory=dict)
    predictions: dict[Causes, HeldOut] = field(default_factory=dict)
    lucky: dict[Causes, float] = field(default_factory=dict)

    def hear(self, fit: Fit) -> None:
        """Remember a fit if it is the best of its causes."""
        key = frozenset(fit.theory.names)
        if key not in self.tried or fit.cost < self.tried[key].cost:
            self.tried[key] = fit

    def fit(self, causes: Causes, near: Causes) -> Fit:
        """The fit of these causes, made from that of others near them if it was never asked for."""
        if causes not in self.tried:
            theory = joined(self.tried[frozenset()].theory, *(self.library[name] for name in sorted(causes)))
            self.hear(self._from(theory, near))
        return self.tried[causes]

    def levelled(self, fewer: Causes, more: Causes) -> None:
        """Fit fewer causes from where more put the string, too: what a fit missed that stopped short is no cause."""
        made, before = self._from(self.tried[fewer].theory, more), self.tried[fewer].cost
        if made.cost < (1 - LEVEL) * before:
            self.hear(made)
            self.lucky.pop(fewer, None)
            for key in [fewer] if fewer else list(self.predictions):  # all are told beside those of no cause
                self.predictions.pop(key, None)

    def _from(self, theory: Theory, near: Causes) -> Fit:
        """A theory fitted from where other causes put the string."""
        other = self.tried[near]
        known = {name: chi for name, chi in other.theory.named(other.chi).items() if name in theory.own}
        return fitted(self.evidence, [theory], [theory.carried(known)], STEPS)[0]

    def held(self, causes: Causes) -> HeldOut:
        """What these causes say of trials that they were not fitted to."""
        if causes not in self.predictions:
            plain = self.held(frozenset()) if causes else None
            self.predictions[causes] = held_out(self.evidence, self.tried[causes], plain)
        return self.predictions[causes]

    def by_chance(self, causes: Causes) -> float:
        """What the best of the library would gain on the noise that these causes leave.

        Of all probes, those first made: without any cause, but where leads came before them.
        """
        if causes not in self.lucky:
            asked = next(iter(self.probes.values()), None) or self.probed(causes)
            self.lucky[causes] = by_chance(self.evidence, self.tried[causes], asked, self.seed) if asked else 0.0
        return self.lucky[causes]

    def probed(self, context: Causes) -> dict[str, list[Probe]]:
        """What every effect of the library but the context's would do beside it, to first order."""
        if context not in self.probes:
            known = candidates(self.base, self.library, self.evidence)
            effects = [effect for effect in known if effect.name not in context]
            self.probes[context] = screened(self.evidence, self.tried[context], effects, self.seed)
        return self.probes[context]

    def mismatch(self, causes: Causes) -> float:
        """What these causes leave that is not noise: half with the simulation's doubt as it was before there was a
        cause, half with it found anew."""
        fit = self.tried[causes]
        first = fit.residual * self.evidence.sigma / self.first.sigma
        return (mismatch(self.evidence, fit.residual) + mismatch(self.first, first)) / 2

    def renewed(self, causes: Causes) -> Court:
        """Beginnings, mass points and doubt found anew where these causes put the string, and all fits made anew."""
        fit = self.tried[causes]
        floor = begun(self.floor, fit.theory.model, fit.chi)
        floor = doubted_beginnings(floor, fit.theory.model, fit.chi)
        evidence = refined(floor, fit.theory, fit.chi)
        floor = replace(floor, segments=evidence.segments)
        court = Court(evidence, self.first, floor, self.base, self.library, self.seed)
        court.probes = dict(self.probes)
        old = list(self.tried.values())
        for made in fitted(evidence, [each.theory for each in old], [each.chi for each in old], AGAIN):
            court.hear(made)
        court.contexts = {c: {n: court.tried[c | {n}] for n in fits} for c, fits in self.contexts.items()}
        return court

    def extended(self, context: Causes) -> dict[str, Fit]:
        """The fits with one cause more than the context, for every promising effect."""
        if context not in self.contexts:
            fit = self.tried[context]
            chosen = promising(self.probed(context))
            explained = self.tried[frozenset()].cost - fit.cost
            for made in shortlisted(self.evidence, fit, chosen, INEXACT * explained):
                self.hear(made)
            names = {probe.effect.name for probe in chosen} & {n for key in self.tried for n in key if key > context}
            self.contexts[context] = {n: self.tried[context | {n}] for n in names if context | {n} in self.tried}
        return self.contexts[context]


def promising(probes: Mapping[str, Sequence[Probe]]) -> list[Probe]:
    """The best probes of every effect that could gain anything."""
    return [probe for some in probes.values() if some[0].gain > PROMISING for probe in _starts(some)]


def _starts(probes: Sequence[Probe]) -> Sequence[Probe]:
    """The best of an effect of one parameter; of others a few, for they differ in place or time."""
    effect = probes[0].effect
    return spread(probes, 1 if len(effect.parameters) == 1 else PROBES if placed(effect) else STARTS)


def shortlisted(evidence: Evidence, fit: Fit, probes: Sequence[Probe], least: float) -> list[Fit]:
    """Fits of the most promising effects: a few steps of all, then the best to their ends.

    What an effect can do once the other parameters follow is not known before they do: the first order alone
    has been seen to put the true cause twelfth. fit: without them. least: gain that would matter; an effect that
    depends on place is closed in on only if it could gain that, and as much as any other does.
    """
    there = dict.fromkeys(probe.effect for probe in probes if placed(probe.effect))
    others = [probe for probe in probes if probe.effect not in there]
    begun = fitted(evidence, [probe.theory for probe in others], [probe.chi for probe in others], FIRST)
    wanted = max([least, *(fit.cost - each.cost for each in begun)]) / UNDERRATED
    for effect in there:
        some = [probe for probe in probes if probe.effect is effect]
        begun += closed_in(evidence, some) if some[0].gain > wanted else []
    best = ranked(begun)[:SHORTLIST]
    return fitted(evidence, [fit.theory for fit in best], [fit.chi for fit in best], STEPS)


def chosen(court: Court, progress: Progress) -> tuple[Court, Causes]:
    """The causes that earn their place: added one by one, then each tried again without and replaced by others.

    Also what was tried in the end: where a cause moves the string elsewhere, the simulation's doubt is found anew.
    """
    best: Causes = frozenset()
    before: set[Causes] = set()  # two that do each other's work could replace each other for ever
    while len(best) < MOST_CAUSES and best not in before and court.mismatch(best) > SUSPECT:
        before.add(best)
        fewer, more = best, _added(court, best)
        if not earns(court, best, more):
            fewer, more = more, _added(court, more)  # of two that are needed, one alone may predict nothing
            if not earns(court, best, more):
                break
        best = _needed(court, _settled(court, fewer, more))
        court = court.renewed(best)
        for name in sorted(best):
            if placed(court.library[name]):
                court.hear(closer(court.evidence, court.tried[best], court.library[name]))
        progress(len(best) / MOST_CAUSES)
    progress(1.0)
    return court, best


def _added(court: Court, causes: Causes) -> Causes:
    """With the one cause more that fits best; as they are where there is none."""
    fits = court.extended(causes)
    return causes | {min(fits, key=lambda name: fits[name].cost)} if fits else causes


def _settled(court: Court, before: Causes, best: Causes) -> Causes:
    """With causes that were there before the last one replaced, where others do better in their place."""
    for cause in (name for name in court.tried[best].theory.names if name in before):
        context = best - {cause}
        if context in court.tried:
            other = _added(court, context)
            better = court.tried[other].cost < court.tried[best].cost
            best = other if better and earns(court, context, other) else best
    return best


def _needed(court: Court, best: Causes) -> Causes:
    """Without causes that no longer earn their place beside the others."""
    for cause in sorted(best):
        without = best - {cause}
        if without:
            court.fit(without, best)
            best = best if earns(court, without, best) else without
    return best


def earns(court: Court, without: Causes, causes: Causes) -> bool:
    """Whether causes move something by enough to matter, cannot be absent, and predict trials not fitted to.

    Of one that acts in a single trial no other trial can say anything: it must explain that trial to the noise.
    """
    court.levelled(without, causes)
    plain, fit = court.tried[without], court.tried[causes]
    acts = moved(court.evidence, plain, fit)
    new = [court.library[name] for name in causes - without]
    if acts.max() < MATTERS or not present(court.evidence, fit, new):
        return False
    explained = court.tried[frozenset()].cost - fit.cost
    least = max(GAIN * noisiness(court.evidence, fit), court.by_chance(causes), INEXACT * explained)
    alone = np.flatnonzero(acts > max(MATTERS, MAINLY * acts.max()))
    if len(alone) == 1 and _explains(court.evidence, fit, int(alone[0])):
        price = PENALTY * (len(fit.theory.free) - len(plain.theory.free))
        return plain.cost - fit.cost > least + price
    if len(acts) == 1:
        return False
    gain = float((court.held(without).costs - court.held(causes).costs).sum())
    return gain > max(least, CONFIRMED * (plain.cost - fit.cost))


def _explains(evidence: Evidence, fit: Fit, trial: int) -> bool:
    """Whether nothing is left to be seen in a trial."""
    return visible(evidence.only([trial]), fit.residual[evidence.trial == trial]) < CLEAR


def noisiness(evidence: Evidence, fit: Fit) -> float:
    """Variance of what the residual has by chance along a smooth direction, over that of white noise.

    From sums over pieces of time along the directions of the fit's own slopes.
    """
    piece = blocks(evidence)
    count = piece.max() + 1
    directions, _ = np.linalg.qr(fit.slopes)
    sums = np.stack([np.bincount(piece, column * fit.residual, count) for column in directions.T])
    return max(float(np.mean((sums**2).sum(axis=1))), 1.0)
