"""The last fit: with more mass points and shorter steps than were needed to find the cause.

Where nobody could see how many there are, a parameter may still hang on them: thousands of points agree on it, and what
is a tenth of the noise in each of them moves it by several of its standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.diagnose.evidence import Evidence, with_shorter_steps
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.intervals import half_width
from stringcast.stages.diagnose.resolve import finer

STEPS = 6
SHORTER = 2.0  # times, steps in time: what both leave is then a quarter each time
LEAST, MOST = 2, 4  # times that it is made finer
FINEST = 40  # segments, from which on it is not made finer for the sake of what still moves
LITTLE = 0.2  # of the half-width of its interval: what the last of them may have changed of a parameter


@dataclass(frozen=True)
class Sharp:
    """fit: with the most mass points and the shortest steps. doubt: by how much the free chi moved when these became
    so many, (free,)."""

    fit: Fit
    doubt: np.ndarray

    def interval(self, evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
        """95 % intervals of the free chi, (free,) each: with what finer simulations than this might still change."""
        half = np.hypot(half_width(evidence, self.fit), self.doubt)
        chi = self.fit.chi[self.fit.theory.free]
        return np.clip(chi - half, 0, 1), np.clip(chi + half, 0, 1)

    def settled(self, evidence: Evidence) -> bool:
        """Whether what still moved is little beside what noise leaves open."""
        return bool(np.all(self.doubt < LITTLE * half_width(evidence, self.fit)))


def sharpened(evidence: Evidence, fit: Fit) -> Sharp:
    """The fit with the next more mass points and steps half as long, and again until its values stay."""
    sharp = Sharp(fit, np.zeros(len(fit.theory.free)))
    for number in range(MOST):
        if number >= LEAST and (sharp.settled(evidence) or evidence.segments[0] >= FINEST):
            break
        evidence = replace(evidence, segments=finer(evidence.segments))
        sharp = _sharper(evidence, sharp.fit)
    return sharp


def _sharper(evidence: Evidence, fit: Fit) -> Sharp:
    theory = replace(fit.theory, model=with_shorter_steps(fit.theory.model, SHORTER))
    (after,) = fitted(evidence, [theory], [fit.chi], STEPS)
    return Sharp(after, np.abs(after.chi - fit.chi)[theory.free])
