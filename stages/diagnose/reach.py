"""How far what depends on place may be from where it was found.

Mass points touch one after the other, so what a plane does follows its place along a bent valley with steps in it, of
which slopes at one place say little. So each of its parameters is led away from where it was found, while all others
follow, until the trials speak against it: 95 % of a profile likelihood, no more certain than their odds ever are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.hypotheses import Hypotheses
from stringcast.stages.diagnose.theory import Theory
from stringcast.stages.diagnose.verdict import log_odds
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.parameter import Parameter

AGAINST = float(gammaincinv(0.5, 0.95))  # log odds at which a place is no longer possible: half of chi squared, 95 %
GROWTH = 2.0  # of a step to the next, if it is allowed; once one was not, steps are halved
FINE = 0.05  # of the way gone: shorter steps are not asked
STEPS = 4  # of the fit of all others


@dataclass(frozen=True)
class _Walk:
    """A parameter on its way. place: its own, in exponents. begun: where it was found. fit: the last one that the
    trials allow. way: (P,) by which the others followed it of late, over what it went itself. step: the next. first:
    the first one. turned: whether one was refused."""

    theory: Theory
    place: int
    begun: float
    fit: Fit
    way: np.ndarray
    step: float
    first: float
    turned: bool = False

    @property
    def next(self) -> np.ndarray:
        """Exponents (P,) from which the others follow."""
        return np.asarray(np.clip(self.fit.chi + self.step * self.way, 0, 1))

    @property
    def ended(self) -> bool:
        """Whether the end of the range is reached, or steps are small again."""
        here = self.fit.chi[self.place]
        least = max(self.first / 2, FINE * abs(here - self.begun))
        return self.next[self.place] == here or (self.turned and abs(self.step) < least)

    def after(self, made: Fit, allowed: bool) -> _Walk:
        """One step later."""
        if not allowed:
            return replace(self, step=self.step / GROWTH, turned=True)
        gone = made.chi - self.fit.chi
        step = self.step / GROWTH if self.turned else self.step * GROWTH
        return replace(self, fit=made, way=gone / gone[self.place], step=step)


def reach(hypotheses: Hypotheses, fit: Fit, effect: type[Effect]) -> dict[str, tuple[float, float]]:
    """Exponents between which each parameter of an effect may be, by qualified name: all places on all ways."""
    walks = [walk for p in effect.parameters for walk in _walks(fit, effect, p)]
    passed = [fit.chi]
    while not all(walk.ended for walk in walks):
        walks = _further(hypotheses, fit, walks)
        passed += [walk.fit.chi for walk in walks]
    far = np.stack(passed)
    places = {name: fit.theory.model.names.index(name) for name in map(effect.qualified, effect.parameters)}
    return {name: (float(far[:, i].min()), float(far[:, i].max())) for name, i in places.items()}


def _walks(fit: Fit, effect: type[Effect], parameter: Parameter) -> list[_Walk]:
    """To both sides; to the lower one alone where no upper one is told."""
    name = effect.qualified(parameter)
    theory, place = replace(fit.theory, held=fit.theory.held | {name}), fit.theory.model.names.index(name)
    covariance = np.linalg.inv(fit.normal)[:, fit.theory.free == place][:, 0]
    own = float(covariance[fit.theory.free == place][0])
    way = np.zeros_like(fit.chi)
    way[fit.theory.free] = covariance / own
    first = np.sqrt(own)  # standard deviation, as slopes have it
    sides = (-1,) if parameter.at_least else (-1, 1)
    return [_Walk(theory, place, float(fit.chi[place]), fit, way, side * first, first) for side in sides]


def _further(hypotheses: Hypotheses, best: Fit, walks: Sequence[_Walk]) -> list[_Walk]:
    """All walks that have not ended one step later, side by side."""
    going = [walk for walk in walks if not walk.ended]
    made = fitted(hypotheses.evidence, [w.theory for w in going], [w.next for w in going], STEPS)
    later = iter([w.after(there, _allowed(hypotheses, there, best)) for w, there in zip(going, made, strict=True)])
    return [walk if walk.ended else next(later) for walk in walks]


def _allowed(hypotheses: Hypotheses, fit: Fit, best: Fit) -> bool:
    return fit.theory.plausible(fit.chi) and log_odds(hypotheses, fit, best) > -AGAINST
