"""Of how many equal mass points what made the trials may consist: another simulation, as Eq. 1 is.

A string of n points moves otherwise than one without: by the last point, of which half is too much, and by what waves
lose between points. Of a real string no such number explains more than none.
"""

from __future__ import annotations

from dataclasses import replace

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.theory import Theory

POINTS = (10, 12, 15, 18, 22, 27, 33, 40, 50)
BETWEEN = 3  # numbers on both sides of the best of these are tried too
STEPS = 6
NEARER = 0.9  # times what is left without points must be left at most
MUCH = 0.6  # of what is left beyond noise without points must be left at most


def grain(evidence: Evidence, fit: Fit) -> int | None:
    """The number of equal points beside which the causes of a fit leave least; None where that is not much less than
    without: then something else is wrong. evidence: with noise alone."""
    left = fitted(evidence, [fit.theory], [fit.chi], STEPS)[0].mean_square  # the fit may have been to less
    tried = {points: _left(evidence, fit, points) for points in POINTS}
    best = min(tried, key=lambda points: tried[points])
    about = range(max(best - BETWEEN, POINTS[0]), best + BETWEEN + 1)
    tried |= {points: _left(evidence, fit, points) for points in about if points not in tried}
    best = min(tried, key=lambda points: tried[points])
    return best if tried[best] < NEARER * left and tried[best] - 1 < MUCH * max(left - 1, 0.0) else None


def _left(evidence: Evidence, fit: Fit, points: int) -> float:
    theory = _made_of(fit.theory, points)
    known = fit.theory.named(fit.chi)
    return fitted(replace(evidence, segments=(points - 1,)), [theory], [theory.carried(known)], STEPS)[0].mean_square


def _made_of(theory: Theory, points: int) -> Theory:
    """The theory with so many equal points."""
    string = replace(theory.model.string, points=points, tip_cell=1.0, grasp_cell=0.0)
    return replace(theory, model=replace(theory.model, string=string))
