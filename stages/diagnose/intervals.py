"""How sure fitted parameters are, and whether a cause could as well be absent."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.special import stdtrit

from stages.diagnose.compare import blocks
from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import Fit
from stages.model.effect import Effect, placed

# What noise alone makes of a parameter is less than what mass points, logs of the arm and pieces of time that go on
# make of it. Twice as wide as noise alone says, intervals held 89 % of 131 parameters on sealed benches (seeds 433 to
# 582); so, 95.9 % of 122 others (583 to 732).
WIDER = 2.4


def interval(evidence: Evidence, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """95 % intervals of the free chi, (free,) each: sandwich over pieces of time (White 1980)."""
    piece = blocks(evidence)
    count = int(piece.max()) + 1
    gradient = fit.slopes * fit.residual[:, None]
    sums = np.stack([np.bincount(piece, column, count) for column in gradient.T], axis=1)
    bread = np.linalg.inv(fit.normal)
    few = count / max(count - len(fit.theory.free), 1)
    deviation = np.sqrt(few * np.sum((sums @ bread) ** 2, axis=0))
    reach = WIDER * stdtrit(max(count - len(fit.theory.free), 1), 0.975) * deviation
    chi = fit.chi[fit.theory.free]
    return np.clip(chi - reach, 0, 1), np.clip(chi + reach, 0, 1)


def present(evidence: Evidence, fit: Fit, effects: Iterable[type[Effect]]) -> bool:
    """Whether no effect's size has an interval that holds its absence: its first parameter, or another in the same
    unit, which is another component of a vector.

    Not asked of what depends on place: something hard is as hard as any, so that its size may be anything, and yet
    the string is elsewhere without it.
    """
    low, high = interval(evidence, fit)
    absent = fit.theory.start[fit.theory.free]
    beyond = {fit.theory.model.names[p]: not low[k] <= absent[k] <= high[k] for k, p in enumerate(fit.theory.free)}
    sized = (e for e in effects if not placed(e))
    return all(any(beyond[e.qualified(p)] for p in e.parameters if p.unit == e.parameters[0].unit) for e in sized)
