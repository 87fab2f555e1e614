"""The base model fitted from nothing.

A string that is swung forgets where it came from, so a whole trial has many local minima:
the beginning is fitted first, from many starts, and the horizon widens while the better half
of them goes on.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted, ranked
from stringcast.stages.diagnose.theory import Theory

FIRST = 0.2  # [s] of every trial that are fitted first
GROWTH = 1.75  # of the horizon, from one to the next
NEARLY = 0.8  # of the longest trial: from there on all is fitted
STEPS = (6, 5, 4)  # at the first horizons; the last of these at all others
LAST = 25
DRAWN = 256


def horizons(evidence: Evidence) -> list[float]:
    """Beginnings of trials that are fitted one after the other [s], before all is."""
    longest = NEARLY * max(float(np.ptp(case.times)) for case in evidence.cases)
    result = [FIRST]
    while result[-1] * GROWTH < longest:
        result.append(result[-1] * GROWTH)
    return result


def searched(
    evidence: Evidence,
    theory: Theory,
    rng: np.random.Generator,
    starts: int,
    progress: Progress = lambda share: None,
) -> list[Fit]:
    """The best fits of a theory, best first. starts: how many of the drawn candidates are followed."""
    free = theory.free
    drawn = np.repeat(theory.start[None], DRAWN, axis=0)
    drawn[:, free] = rng.uniform(0, 1, (DRAWN, len(free)))
    beginning = evidence.rough.until(FIRST)
    order = np.argsort(np.sum(np.minimum(beginning.residuals(theory.model, drawn) ** 2, 1e4), axis=1))
    chi = list(drawn[order[:starts]])
    seconds = horizons(evidence)
    for number, horizon in enumerate(seconds):
        some, steps = evidence.rough.until(horizon), STEPS[min(number, len(STEPS) - 1)]
        fits = ranked(fitted(some, [theory] * len(chi), chi, steps))
        chi = [fit.chi for fit in fits[: max(len(chi) // 2, 2)]]
        progress((number + 1) / (len(seconds) + 1))
    fits = fitted(evidence, [theory] * len(chi), chi, LAST)
    progress(1.0)
    return ranked(fits)
