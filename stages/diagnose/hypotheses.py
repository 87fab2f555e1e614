"""Every set of causes that was tried on some evidence, each fitted once, and what it says of trials not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stringcast.stages.diagnose.beginning import begun, doubted_beginnings
from stringcast.stages.diagnose.chance import by_chance
from stringcast.stages.diagnose.closing import PROBES, closed_in
from stringcast.stages.diagnose.compare import HeldOut, held_out
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import LITTLE, Fit, fitted, fixed, ranked
from stringcast.stages.diagnose.noise import mismatch
from stringcast.stages.diagnose.onset import since
from stringcast.stages.diagnose.ranges import ranged, widened, with_ranges
from stringcast.stages.diagnose.resolve import refined
from stringcast.stages.diagnose.screen import Probe, screened, spread
from stringcast.stages.diagnose.sharpen import Sharp, sharpened
from stringcast.stages.diagnose.single_effects.proposals import candidates
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.model.effect import Effect, placed
from stringcast.stages.model.model import Model

Causes = frozenset[str]

FIRST = 2  # steps of every promising effect's fit
AGAIN = 4  # of a fit where doubt was found anew
SHORTLIST = 6  # fits that then go on
STARTS = 2  # probes or places of each from which it is fitted
PROMISING = 5.0  # of a predicted gain of the log-likelihood
UNDERRATED = 3.0  # times what first order says of an effect that depends on place, it may gain
STEPS = 14
LEVEL = 0.01  # of a cost, by which another fit of the same causes must be better to count
INEXACT = 0.002  # share of what a right model explains by which it may be wrong, and no cause be behind it


@dataclass
class Hypotheses:
    """What has been tried so far on this evidence: each set of causes is fitted once.

    evidence: with the simulation's doubt; first: as it was when causes were first sought in these points; floor: with
    noise alone. led: whether fits from elsewhere came before any that screening would find.
    """

    evidence: Evidence
    first: Evidence
    floor: Evidence
    base: Model
    library: Mapping[str, type[Effect]]
    seed: int
    tried: dict[Causes, Fit] = field(default_factory=dict)
    contexts: dict[Causes, Causes] = field(default_factory=dict)
    probes: dict[Causes, dict[str, list[Probe]]] = field(default_factory=dict)
    predictions: dict[Causes, HeldOut] = field(default_factory=dict)
    chance_gains: dict[Causes, float] = field(default_factory=dict)
    sharpened: dict[Causes, Sharp] = field(default_factory=dict)
    led: bool = False

    def add(self, fit: Fit) -> None:
        """Remember a fit if it is the best of its causes, and forget what was said of the one before."""
        key = frozenset(fit.theory.names)
        if key in self.tried and fit.cost > self.tried[key].cost - LITTLE:
            return
        self.tried[key] = fit
        self.sharpened.pop(key, None)
        self.chance_gains.pop(key, None)
        for told in [key] if key else list(self.predictions):  # all are told beside those of no cause
            self.predictions.pop(told, None)

    def begin_with(self, fits: Sequence[Fit]) -> None:
        """Remember fits from elsewhere, and let single causes among all come before any that screening would find."""
        for fit in fits:
            self.add(fit)
        alone = frozenset(name for key in self.tried if len(key) == 1 for name in key)
        if alone:
            self.contexts[frozenset()], self.led = alone, True

    def fit(self, causes: Causes, near: Causes) -> Fit:
        """The fit of these causes, made from that of others near them if it was never asked for."""
        if causes not in self.tried:
            theory = joined(self.tried[frozenset()].theory, *(self.library[name] for name in sorted(causes)))
            self.add(self._from(theory, near))
        return self.tried[causes]

    def refitted(self, fewer: Causes, more: Causes) -> None:
        """Fit fewer causes from where more put the string, too: what a fit missed that stopped short is no cause."""
        made, before = self._from(self.tried[fewer].theory, more), self.tried[fewer].cost
        if made.cost < (1 - LEVEL) * before:
            self.add(made)

    def level(self, others: Sequence[Causes], best: Causes) -> None:
        """Fit others from where the best put the string, too; what only they have begins as it was."""
        old = [self.tried[key] for key in others]
        starts = [carried(fit.theory, fit, self.tried[best]) for fit in old]
        for fit in fitted(self.evidence, [fit.theory for fit in old], starts, STEPS):
            self.add(fit)

    def _from(self, theory: Theory, near: Causes) -> Fit:
        """A theory fitted from where other causes put the string."""
        return fitted(self.evidence, [theory], [carried(theory, self.tried[near])], STEPS)[0]

    def held(self, causes: Causes) -> HeldOut:
        """What these causes say of trials that they were not fitted to."""
        if causes not in self.predictions:
            plain = self.held(frozenset()) if causes else None
            self.predictions[causes] = held_out(self.evidence, self.tried[causes], plain)
        return self.predictions[causes]

    def foretells(self, without: Causes, causes: Causes) -> float:
        """Gain of the log-likelihood on trials left out by causes over fewer of them.

        Planes that both have stay where all trials put them: a trial that alone shows where one is would be foretold
        wrongly by both, and nothing could be said of anything else.
        """
        shared = {name for name in without if placed(self.library[name])}
        if not shared:
            return float((self.held(without).costs - self.held(causes).costs).sum())
        plain = held_out(self.evidence, fixed(self.tried[without], shared))
        return float((plain.costs - held_out(self.evidence, fixed(self.tried[causes], shared), plain).costs).sum())

    def by_chance(self, causes: Causes) -> float:
        """What the best of the library would gain on the noise that these causes leave.

        Of all probes, those first made: without any cause, but where leads came before them.
        """
        if causes not in self.chance_gains:
            asked = next(iter(self.probes.values()), None) or self.probed(causes)
            self.chance_gains[causes] = by_chance(self.evidence, self.tried[causes], asked, self.seed) if asked else 0.0
        return self.chance_gains[causes]

    def sharp(self, causes: Causes) -> Sharp:
        """The last fit of these causes, with more mass points and shorter steps: when nothing is added any more."""
        if causes not in self.sharpened:
            self.sharpened[causes] = sharpened(self.evidence, self.tried[causes])
        return self.sharpened[causes]

    def probed(self, context: Causes) -> dict[str, list[Probe]]:
        """What every effect of the library but the context's would do beside it, to first order."""
        if context not in self.probes:
            known = candidates(self.base, self.library, self.evidence.cases)
            effects = [effect for effect in known if effect.name not in context]
            self.probes[context] = screened(self.evidence, self.tried[context], effects, self.seed)
        return self.probes[context]

    def mismatch(self, causes: Causes) -> float:
        """What these causes leave that is not noise: half with the simulation's doubt as it was first, half with it
        found anew."""
        fit = self.tried[causes]
        first = fit.residual * self.evidence.sigma / self.first.sigma
        return (mismatch(self.evidence, fit.residual) + mismatch(self.first, first)) / 2

    def explained(self, causes: Causes) -> bool:
        """Whether these causes leave nothing to be seen."""
        return self.mismatch(causes) < 0

    def renewed(self, causes: Causes) -> Hypotheses:
        """Beginnings, mass points and doubt found anew where these causes put the string, ranges widened that are too
        narrow beside them, and all fits made anew."""
        fit = self.tried[causes]
        floor = begun(self.floor, fit.theory.model, fit.chi)
        floor = doubted_beginnings(floor, fit.theory.model, fit.chi)
        evidence = refined(floor, fit.theory, fit.chi)
        floor = replace(floor, segments=evidence.segments)
        best = widened(evidence, [fit])[0]
        fresh = Hypotheses(evidence, self.first, floor, self.base, self.library, self.seed)
        old = list(self.tried.values())
        theories, starts = [each.theory for each in old], [each.chi for each in old]
        if best is fit:
            fresh.probes = dict(self.probes)
        else:
            ranges = best.theory.model.string.ranges
            fresh.base = with_ranges(self.base, ranges)
            theories = [ranged(theory, ranges) for theory in theories]
            starts = [theory.at(each.values) for theory, each in zip(theories, old, strict=True)]
            fresh.add(best)
        for made in fitted(evidence, theories, starts, AGAIN):
            fresh.add(made)
        fresh.contexts = dict(self.contexts)
        fresh.led = self.led
        return fresh

    def on_other_evidence(self, evidence: Evidence, floor: Evidence, base: Fit, causes: Causes) -> Hypotheses:
        """All fits made anew on other evidence, what was screened to be asked again, and causes that depend on place
        sought anew. floor: with noise alone. base: fit to it without causes."""
        fresh = Hypotheses(evidence, evidence, floor, self.base, self.library, self.seed)
        fresh.add(base)
        old = [fit for key, fit in self.tried.items() if key]
        for made in fitted(evidence, [each.theory for each in old], [each.chi for each in old], AGAIN):
            fresh.add(made)
        for name in sorted(causes):
            if placed(self.library[name]):
                beside = fresh.fit(causes - {name}, causes)
                for found in since(evidence, beside, self.library[name], self.seed):
                    fresh.add(found)
        if self.led:
            fresh.begin_with([])
        return fresh

    def extended(self, context: Causes) -> dict[str, Fit]:
        """The fits with one cause more than the context, for every promising effect."""
        if context not in self.contexts:
            fit = self.tried[context]
            chosen = promising(self.probed(context))
            explained = self.tried[frozenset()].cost - fit.cost
            for made in shortlisted(self.evidence, fit, chosen, INEXACT * explained, self.seed):
                self.add(made)
            names = {probe.effect.name for probe in chosen} & {n for key in self.tried for n in key if key > context}
            self.contexts[context] = frozenset(n for n in names if context | {n} in self.tried)
        return {name: self.tried[context | {name}] for name in sorted(self.contexts[context])}


def carried(theory: Theory, *fits: Fit) -> np.ndarray:
    """(P,) exponents of what a theory fits, each from the last of these fits that has it."""
    known: dict[str, float] = {}
    for fit in fits:
        known |= fit.theory.named(fit.chi)
    return theory.carried({name: chi for name, chi in known.items() if name in theory.own})


def promising(probes: Mapping[str, Sequence[Probe]]) -> list[Probe]:
    """The best probes of every effect that could gain anything."""
    return [probe for some in probes.values() if some[0].gain > PROMISING for probe in _starts(some)]


def _starts(probes: Sequence[Probe]) -> Sequence[Probe]:
    """The best of an effect of one parameter; of others a few, for they differ in place or time."""
    effect = probes[0].effect
    return spread(probes, 1 if len(effect.parameters) == 1 else PROBES if placed(effect) else STARTS)


def shortlisted(evidence: Evidence, fit: Fit, probes: Sequence[Probe], least: float, seed: int) -> list[Fit]:
    """Fits of the most promising effects: a few steps of all, then the best to their ends.

    What an effect can do once the other parameters follow is not known before they do: the first order alone
    has been seen to put the true cause twelfth. fit: without them. least: gain that would matter; an effect that
    depends on place is closed in on only if it could gain that, and as much as any other does: from where something is
    first seen, or, where that says nothing, from its probes.
    """
    there = dict.fromkeys(probe.effect for probe in probes if placed(probe.effect))
    others = [probe for probe in probes if probe.effect not in there]
    begun = fitted(evidence, [probe.theory for probe in others], [probe.chi for probe in others], FIRST)
    wanted = max([least, *(fit.cost - each.cost for each in begun)]) / UNDERRATED
    for effect in there:
        some = [probe for probe in probes if probe.effect is effect]
        if some[0].gain > wanted:
            begun += (since(evidence, fit, effect, seed) or closed_in(evidence, some))[:STARTS]
    best = ranked(begun)[:SHORTLIST]
    return fitted(evidence, [fit.theory for fit in best], [fit.chi for fit in best], STEPS)
