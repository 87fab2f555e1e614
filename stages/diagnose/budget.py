"""The error budget: what each cause, the numerical error, noise and the unknown are of the misfit at the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.diagnose.prepared import Prepared
from stringcast.stages.diagnose.single_effects import Found, refitted
from stringcast.stages.inference.evidence import Fit, tip_draws
from stringcast.stages.inference.hypothesis import Hypothesis


@dataclass(frozen=True)
class Entry:
    """One source. tip_rms: root mean square at the tip over all trials [m]; log_evidence: what is lost without a cause,
    NaN of what is none."""

    source: str
    tip_rms: float
    log_evidence: float = float("nan")


@dataclass(frozen=True)
class Budget:
    """entries: whose squares add up to the square of the base model's misfit at the tip. unexplained:
    value and 95 % interval of what is left [m]. by_cause: the fits with the first causes, none first."""

    entries: tuple[Entry, ...]
    unexplained: tuple[float, float, float]
    by_cause: tuple[Fit, ...]


def budgeted(found: Found, base: Fit, rng: np.random.Generator) -> Budget:
    """Causes share in the order in which they entered. What is left of the misfit beside noise and numerical error, as
    these are known, is unexplained. base: the base model's fit to the same data."""
    data, fits = found.prepared.data, one_after_another(found, base)
    begun = [data.of(fit.hypothesis).begun(fit.residuals, fit.sizes) for fit in fits]
    squares = np.minimum.accumulate([np.mean(data.tip_rms(each) ** 2) for each in begun])  # [m2], over trials
    noise, numerical = _known(found.prepared)
    left = float(squares[-1])
    numerical = min(numerical, left)
    noise = min(noise, left - numerical)
    names, full = found.fit.hypothesis.names, fits[-1]
    lost = [full.evidence - refitted(data, full, full.hypothesis.without(c)).evidence for c in full.hypothesis.causes]
    shares = squares[:-1] - squares[1:]  # of what explains nothing 0, not -0
    entries = [Entry(n, float(np.sqrt(s)), e) for n, s, e in zip(names, shares, lost, strict=True)]
    rest = [("numerical error", numerical), ("noise", noise), ("unexplained", left - numerical - noise)]
    entries += [Entry(name, float(np.sqrt(max(square, 0.0)))) for name, square in rest]
    drawn = np.sqrt(np.mean(tip_draws(data, full, rng) ** 2, axis=0))
    low, high = np.quantile(drawn, [0.025, 0.975]).tolist()
    value = entries[-1].tip_rms
    ends = (value, min(low, value), max(high, value))
    return Budget(tuple(entries), ends, tuple(fits))


def one_after_another(found: Found, base: Fit) -> list[Fit]:
    """The fits with no cause, with the first, and so on, to the same data."""
    data, full = found.prepared.data, found.fit
    if not full.hypothesis.causes:
        return [full]
    some = [full.hypothesis.causes[:k] for k in range(1, len(full.hypothesis.causes))]
    between = [refitted(data, full, Hypothesis(full.hypothesis.base, causes)) for causes in some]
    return [base, *between, full]


def _known(prepared: Prepared) -> tuple[float, float]:
    """Mean squares at the tip that noise, and what is in doubt of the numerical error, leave [m2]."""
    noise = [2 * np.mean(trial.sigma[trial.tip] ** 2) for trial in prepared.data.trials]
    return float(np.mean(noise)), float(np.mean(prepared.doubt**2))
