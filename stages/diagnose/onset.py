"""Where something is first seen: what a string touches does nothing before it is touched.

Later the string is elsewhere, and what it does there says little of where it touched. So every trial is followed for
as long as it is explained, and an effect that depends on place is sought where it acts just before something is seen
in the trials that show something, and nowhere else. A touch may last for a hundredth of the string's way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from stringcast.data.later import Later
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted, ranked
from stringcast.stages.diagnose.noise import CLEAR, visible_in_each
from stringcast.stages.diagnose.screen import about, followed, start_of, varied
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.model.effect import Effect

stats = Later("scipy.stats")

FIRST = 0.15  # [s] of every trial, which must show nothing
GROWTH = 1.25  # of the horizon, from one to the next
SHOWN = (3.0, CLEAR)  # standard deviations that neighbours share: a graze may be over before it is clear
WINDOW = GROWTH**2  # of the time after which something is seen: the touch is in what is so much shorter or longer
STEPS, SURE = 4, 20  # of a fit; and further ones, before it is said that something is seen
DRAWS = 14  # places of which it is asked whether they are touched when they should be, as a power of two
NEAR, MORE = 0.03, 1024  # of a range: so near to those that are, so many more are asked
PLACES = 64  # that are simulated
SIZES = (0.02, 0.045, 0.2)  # exponents at which they are: of planes, from a cushion to a table
OTHERS = (0.0, 0.3)  # exponents of other sizes of the effect, of friction say, that may matter as much
REACHES = (0.03, 0.015, 0.008)  # of a range, within which places are tried about the best
BEST, ABOUT = 3, 12  # how many are gone about, places about each
FITTED, KEPT = 3, 2  # of each size, how many are fitted, and how many of these go on


@dataclass(frozen=True)
class Onset:
    """fit: of all beginnings that it explains. ends: how long these are, of each trial [s]; infinite where all is."""

    fit: Fit
    ends: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """Numbers of the trials that show something later."""
        return np.flatnonzero(np.isfinite(self.ends))


def onset(evidence: Evidence, fit: Fit, shown: float) -> Onset | None:
    """Until when each trial is explained; None where one is never, or all always are.

    shown: standard deviations that neighbours share, of what is something. A trial that shows something takes the fit
    along, and others with it: these are asked again without it.
    """
    ends = np.full(len(evidence.cases), np.inf)
    sound, seconds = fit, FIRST
    while seconds < GROWTH * _lengths(evidence).max():
        tried, seen = _beginning(evidence.until(np.minimum(ends, seconds)), sound, np.isinf(ends), shown)
        if seen.max() < shown:
            sound, seconds = tried, seconds * GROWTH
        elif seconds < GROWTH * FIRST:
            return None
        else:
            ends[np.argmax(seen)] = seconds / GROWTH
    return Onset(sound, ends) if np.isfinite(ends).any() else None


def _beginning(evidence: Evidence, start: Fit, asked: np.ndarray, shown: float) -> tuple[Fit, np.ndarray]:
    """A fit of beginnings, and what it leaves to be seen in each trial that is asked about, (K,). What a fit leaves
    that has not come to its end may be nothing."""
    for steps in (STEPS, SURE):
        start = fitted(evidence, [start.theory], [start.chi], steps)[0]
        seen = np.where(asked, visible_in_each(evidence, start.residual), 0.0)
        if seen.max() < shown:
            break
    return start, seen


def since(evidence: Evidence, fit: Fit, effect: type[Effect], seed: int) -> list[Fit]:
    """Fits of an effect that depends on place beside the causes of `fit`, of all the evidence, best first: none where
    no place would be touched when something is first seen."""
    begun = {each.ends.tobytes(): each for shown in SHOWN if (each := onset(evidence, fit, shown))}
    found = [_carried_on(evidence, each, _Sought.after(each, fit, effect), seed) for each in begun.values()]
    return ranked([fit for some in found for fit in some])


def _carried_on(evidence: Evidence, begun: Onset, sought: _Sought, seed: int) -> list[Fit]:
    """Fits to what comes just after the onset go on to more and more of the trials, those of each size by themselves:
    what is soft may follow the first touch better and the rest worse, and is nowhere near what is hard."""
    chi = _touched(evidence, begun, sought, seed)
    if not len(chi):
        return []
    ends = begun.ends * GROWTH
    kinds = [list(_nearest(evidence.until(ends), sought, chi, size, seed)) for size in SIZES]
    while np.isfinite(ends).any():
        fits = _side_by_side(evidence.until(ends), sought.theory, kinds)
        kinds = [[fit.chi for fit in ranked(some)[:KEPT]] for some in fits]
        ends = np.where(ends < _lengths(evidence), ends * GROWTH, np.inf)
    return ranked([fit for some in _side_by_side(evidence, sought.theory, kinds) for fit in some])


def _side_by_side(evidence: Evidence, theory: Theory, kinds: Sequence[Sequence[np.ndarray]]) -> list[list[Fit]]:
    """Fits of every kind."""
    starts = [chi for some in kinds for chi in some]
    fits = iter(fitted(evidence, [theory] * len(starts), starts, STEPS))
    return [list(islice(fits, len(some))) for some in kinds]


def _lengths(evidence: Evidence) -> np.ndarray:
    """Of the trials [s]."""
    return np.array([np.ptp(case.times) for case in evidence.cases])


@dataclass(frozen=True)
class _Sought:
    """An effect whose place is sought. start: (P,) where it is absent. Places of exponents: size, where, and others,
    which are sizes too."""

    theory: Theory
    effect: type[Effect]
    start: np.ndarray
    size: int
    where: list[int]
    others: list[int]

    @classmethod
    def after(cls, begun: Onset, fit: Fit, effect: type[Effect]) -> _Sought:
        """Beside the causes of a fit, all else as in the beginnings."""
        theory = joined(fit.theory, effect)
        size, *where = varied(theory, effect)
        others = [i for i in theory.places(effect, effect.parameters) if i not in (size, *where)]
        return cls(theory, effect, start_of(theory, begun.fit), size, where, others)

    def pushed(self, chi: np.ndarray, way: Mapping[str, np.ndarray]) -> np.ndarray:
        """Whether the effect pushes anywhere on a way of the string, (C,)."""
        return np.asarray(self.theory.pushed(self.effect, chi, way).any(axis=1))

    def varied_about(self, chi: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
        """Others within reach of exponents (C, P), exponents of sizes up to twice and down to half of theirs."""
        near, sizes = about(chi, self.where, reach, rng), [self.size, *self.others]
        near[:, sizes] *= rng.uniform(0.5, 2.0, (len(near), len(sizes)))
        near = np.clip(near, 0, 1)
        return near[[self.theory.plausible(each) for each in near]]


def _touched(evidence: Evidence, begun: Onset, sought: _Sought, seed: int) -> np.ndarray:
    """Exponents (C, P) of places that are touched when something is first seen, and not before nor elsewhere."""
    rng = np.random.default_rng(seed)
    chi = np.repeat(sought.start[None], 2**DRAWS, axis=0)
    chi[:, sought.size] += SIZES[0] * (1 - chi[:, sought.size])
    chi[:, sought.where] = stats.qmc.Sobol(len(sought.where), seed=seed).random_base2(DRAWS)
    found = _fitting(evidence, begun, sought, chi)
    if not len(found):
        return found
    near = sought.varied_about(found[rng.integers(len(found), size=MORE)], NEAR, rng)
    found = np.concatenate([found, _fitting(evidence, begun, sought, near)])
    return found[rng.permutation(len(found))[:PLACES]]


def _fitting(evidence: Evidence, begun: Onset, sought: _Sought, chi: np.ndarray) -> np.ndarray:
    """Those of exponents (C, P) with which every trial that shows something is touched about then, none before, and
    the hand never."""
    chi = chi[~sought.theory.on_hand(sought.effect, chi)]  # first: the hand's way is short
    late = evidence.until(begun.ends * WINDOW)
    for trial in begun.seen:
        way = followed(late.only([trial]), begun.fit)
        chi = chi[sought.pushed(chi, way)]
    clear = followed(evidence.until(begun.ends / WINDOW), begun.fit)
    return chi[~sought.pushed(chi, clear)]


def _nearest(evidence: Evidence, sought: _Sought, chi: np.ndarray, size: float, seed: int) -> np.ndarray:
    """The best of places (C, P) at a size, and of others about them, (FITTED, P)."""
    rng = np.random.default_rng(seed)
    tried = np.concatenate([_sized(sought, chi, size, other) for other in OTHERS])
    costs = _costs(evidence, sought, tried)
    for reach in REACHES:
        best = np.repeat(tried[np.argsort(costs)[:BEST]], ABOUT, axis=0)
        near = sought.varied_about(best, reach, rng)
        tried, costs = np.concatenate([tried, near]), np.append(costs, _costs(evidence, sought, near))
    return np.asarray(tried[np.argsort(costs)[:FITTED]])


def _sized(sought: _Sought, chi: np.ndarray, size: float, other: float) -> np.ndarray:
    sized = chi.copy()
    sized[:, sought.size], sized[:, sought.others] = size, other
    return sized


def _costs(evidence: Evidence, sought: _Sought, chi: np.ndarray) -> np.ndarray:
    return np.asarray(np.sum(evidence.residuals(sought.theory.model, chi) ** 2, axis=1))
