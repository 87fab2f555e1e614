"""Closing in on an effect that depends on place: a plane or a box that the string touches.

A string that touches a little more or less moves elsewhere, so that most places are in the
basin of a wrong one, and the first steps of a fit often lead astray. Many probes are begun, of
which fewer and fewer go on; then places about the best are tried for what they really cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted, ranked
from stringcast.stages.diagnose.screen import Probe, about, varied
from stringcast.stages.model.effect import Effect

PROBES = 8  # from which it begins
ROUNDS = ((PROBES, 2), (4, 3), (2, 3))  # how many go on, and steps of each
REACHES = (0.06, 0.04, 0.03, 0.02)  # of a range, within which places are tried about the best
KEPT, ABOUT, FITTED = 2, 24, 4  # how many are gone about, places about each, and how many of these are fitted
STEPS = 4
LAST = 2  # steps with all mass points
FINE = (0.03, 0.015, 0.008)  # reaches about a place that has been chosen


def closed_in(evidence: Evidence, probes: Sequence[Probe]) -> list[Fit]:
    """The best fits of an effect, best first, from probes of it."""
    theory = probes[0].theory
    chi = [probe.chi for probe in probes]
    for count, steps in ROUNDS:
        fits = ranked(fitted(evidence.rough, [theory] * len(chi[:count]), chi[:count], steps))
        chi = [fit.chi for fit in fits]
    rng = np.random.default_rng(0)
    where = varied(theory, probes[0].effect)[1:]
    for reach in REACHES:
        fits = ranked([*fits, *_about(evidence.rough, fits[:KEPT], where, reach, rng)])
    return ranked(fitted(evidence, [theory] * KEPT, [fit.chi for fit in fits[:KEPT]], LAST))


def closer(evidence: Evidence, fit: Fit, effect: type[Effect]) -> Fit:
    """The best fit that there is near the place of an effect, with all mass points."""
    rng = np.random.default_rng(0)
    where = varied(fit.theory, effect)[1:]
    fits = [fit]
    for reach in FINE:
        fits = ranked([*fits, *_about(evidence, fits[:1], where, reach, rng)])
    return fits[0]


def _about(
    evidence: Evidence, fits: Sequence[Fit], where: Sequence[int], reach: float, rng: np.random.Generator
) -> list[Fit]:
    """Fits from the best of many places within reach of those given."""
    theory = fits[0].theory
    chi = about(np.repeat(np.stack([fit.chi for fit in fits]), ABOUT, axis=0), where, reach, rng)
    chi = chi[[theory.plausible(each) for each in chi]]
    cost = np.sum(evidence.residuals(theory.model, chi) ** 2, axis=1)
    chosen = np.argsort(cost)[:FITTED]
    return fitted(evidence, [theory] * len(chosen), list(chi[chosen]), STEPS)
