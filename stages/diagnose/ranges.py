"""Ranges of the string's parameters that end too early: a guess about strings must not make a cause of what a stiffer
string is, or a firmer grip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted, ranked
from stringcast.stages.diagnose.theory import Theory
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter

STEPS = 20
WIDENINGS = 6  # of a range, at most
WIDER = 10.0
AT_END = 0.02  # of a range
PRESSED = 10.0  # of the log-likelihood that lies beyond an end


def widened(evidence: Evidence, found: Sequence[Fit]) -> list[Fit]:
    """The two best fits of a theory, with wider ranges for parameters that the data press against an end of theirs."""
    fits = list(found[:2])
    for _ in range(WIDENINGS):
        ranges = pressed(fits[0])
        if not ranges:
            break
        theory = ranged(fits[0].theory, ranges)
        fits = fitted(evidence, [theory] * len(fits), [theory.at(fit.values) for fit in fits], STEPS)
        fits = ranked(fits)
    return fits


def pressed(fit: Fit) -> dict[str, Parameter]:
    """The string's own parameters at an end of their range beyond which the fit would gain, with the range that goes on
    there. Causes have theirs: something hard is as hard as any."""
    gradient = fit.slopes.T @ fit.residual
    gain = gradient**2 / (2 * np.maximum(np.diag(fit.normal), 1e-12))
    ranges = {}
    for place, (number, slope, more) in enumerate(zip(fit.theory.free, gradient, gain, strict=True)):
        parameter, chi = fit.theory.model.parameters[number], fit.chi[fit.theory.free[place]]
        if more < PRESSED or parameter.low <= 0 or parameter.name in fit.theory.model.measured:
            continue
        if parameter.name not in fit.theory.base:
            continue
        if chi > 1 - AT_END and slope < 0:
            ranges[parameter.name] = replace(parameter, high=parameter.high * WIDER)
        elif chi < AT_END and slope > 0:
            ranges[parameter.name] = replace(parameter, low=parameter.low / WIDER)
    return ranges


def ranged(theory: Theory, ranges: Mapping[str, Parameter]) -> Theory:
    """The theory with other ranges of the string's own parameters, by name."""
    return replace(theory, model=with_ranges(theory.model, ranges))


def with_ranges(model: Model, ranges: Mapping[str, Parameter]) -> Model:
    """The model with them."""
    return replace(model, string=replace(model.string, ranges={**model.string.ranges, **ranges}))
