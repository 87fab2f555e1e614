"""Leads: causes found in the beginnings of trials whose ends are too far off to say anything of why.

A hard-swung string forgets where it came from. Joints that are a little late put its tip elsewhere half a second
later, and from there on neither a fit nor what an effect does to first order says anything of them; in the beginning
both do. What is found there is followed as the horizon widens, as the base model is in `search`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.schema import DataError
from stringcast.stages.diagnose.choose import chosen
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.hypotheses import SHORTLIST, STEPS, Causes, Hypotheses
from stringcast.stages.diagnose.prepare import Ground
from stringcast.stages.diagnose.search import horizons
from stringcast.stages.diagnose.theory import joined

ASTRAY = 0.1  # of the string's length: a base model that is further off is not near enough to be mended
EACH = 5  # steps of a fit at every horizon


def astray(ground: Ground) -> bool:
    """Whether the base model is so far off that the whole of the trials says nothing of why."""
    off = ground.base.residual * ground.evidence.sigma
    return float(np.sqrt(2 * np.mean(off**2))) > ASTRAY * ground.model.string.length


def beginnings(observations: Sequence[Observation], seconds: float) -> list[Observation]:
    """The first of every trial."""
    return [replace(o, points=o.points[o.points["t"] <= o.points["t"].min() + seconds]) for o in observations]


def follow(hypotheses: Hypotheses, early: Callable[[float], tuple[Ground, Hypotheses]]) -> None:
    """Add to the hypotheses what the longest beginnings say that the base model can follow.

    early: ground and hypotheses of the beginnings of all trials, of so many seconds. Where the base model follows none,
    or some trial has no beginning, nothing is added.
    """
    seconds = horizons(hypotheses.evidence)
    for number, horizon in reversed(list(enumerate(seconds))):
        try:
            ground, own = early(horizon)
        except DataError:
            return
        if not astray(ground):
            own, causes = chosen(own, lambda share: None)
            if causes:
                _carried_on(hypotheses, leads(own, causes), seconds[number + 1 :])
            return


def leads(hypotheses: Hypotheses, causes: Causes) -> list[Fit]:
    """The best of what was tried, and what was chosen with each part of it: causes are added one by one."""
    tried = {some: fit for some, fit in hypotheses.tried.items() if some}
    best = sorted(tried, key=lambda some: tried[some].cost)[:SHORTLIST]
    return [tried[some] for some in dict.fromkeys([*best, *(some for some in tried if some <= causes)])]


def _carried_on(hypotheses: Hypotheses, fits: Sequence[Fit], seconds: Sequence[float]) -> None:
    """Fits of beginnings go on to longer ones, and then to all the evidence, and are added."""
    base = hypotheses.tried[frozenset()].theory
    theories = [joined(base, *fit.theory.causes) for fit in fits]
    # Ranges that were widened for the beginnings need not be those of the whole.
    chi = [theory.at(fit.values) for theory, fit in zip(theories, fits, strict=True)]
    for horizon in seconds:
        chi = [fit.chi for fit in fitted(hypotheses.evidence.rough.until(horizon), theories, chi, EACH)]
    hypotheses.begin_with(fitted(hypotheses.evidence, theories, chi, STEPS))
