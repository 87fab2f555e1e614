"""Causes that are another in each trial: a grasp at another angle, a string that was bent in between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.diagnose.fit import fitted
from stringcast.stages.diagnose.hypotheses import Causes, Hypotheses
from stringcast.stages.diagnose.noise import systematic
from stringcast.stages.diagnose.screen import Probe, varied
from stringcast.stages.model.effect import Effect

STEPS = 5
MOSTLY = 0.5  # share of the misfit that has to go
FURTHER = 2.0  # times what the effect explains with one value for all trials
ALIKE = 0.8  # of the best one's gain: effects that do it about as well


@dataclass(frozen=True)
class Differing:
    """effect: the one that explains most with a value of its own in each trial. values: by trial, in its unit.
    explained: share of the systematic misfit. alike: others that would do about as well."""

    effect: type[Effect]
    values: Mapping[str, float]
    explained: float
    alike: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What to say of it."""
        unit = self.effect.parameters[0].unit
        values = ", ".join(f"{value:.3g}" for value in self.values.values())
        others = f" ({' or '.join(self.alike)} would do about as well)" if self.alike else ""
        share = f"{100 * self.explained:.0f} % of it"
        return f"The trials differ: {self.effect.name} of its own in each, {values} {unit}, explains {share}{others}."


def differing(hypotheses: Hypotheses, causes: Causes) -> Differing | None:
    """The effect that explains most of what these causes leave if each trial has its own; None where none does."""
    gains = {some[0].effect: _gains(hypotheses, causes, some) for some in hypotheses.probed(causes).values()}
    single = {effect: gain for effect, gain in gains.items() if len(effect.parameters) == 1}
    if not single or len(hypotheses.evidence.cases) == 1:
        return None
    effect = max(single, key=lambda e: single[e][0])
    each, common = single[effect]
    if each < FURTHER * common:
        return None
    values, explained = _fitted(hypotheses, causes, effect)
    alike = tuple(e.name for e, gain in single.items() if e is not effect and gain[0] > ALIKE * each)
    return Differing(effect, values, explained, alike) if explained > MOSTLY else None


def _gains(hypotheses: Hypotheses, causes: Causes, probes: list[Probe]) -> tuple[float, float]:
    """Gain of the log-likelihood, to first order, with a size for each trial and with one for all."""
    residual, trial = hypotheses.tried[causes].residual, hypotheses.evidence.trial
    best = (0.0, 0.0)
    for probe in probes:
        along = np.bincount(trial, probe.direction * residual)
        size = np.maximum(np.bincount(trial, probe.direction**2), 1e-12)
        best = max(best, (float(np.sum(along**2 / size)) / 2, float(along.sum()) ** 2 / 2))
    return best


def _fitted(hypotheses: Hypotheses, causes: Causes, effect: type[Effect]) -> tuple[dict[str, float], float]:
    """The effect's value in each trial [its unit], all else as it is, and the share of the misfit that it explains."""
    probe, fit = hypotheses.probed(causes)[effect.name][0], hypotheses.tried[causes]
    alone = replace(probe.theory, causes=(effect,), base=())
    start = probe.theory.carried(probe.theory.named(probe.chi) | fit.theory.named(fit.chi))
    place, values, left = varied(alone, effect)[0], {}, []
    for number, case in enumerate(hypotheses.evidence.cases):
        own = fitted(hypotheses.evidence.only([number]), [alone], [start], STEPS)[0]
        values[case.name] = float(alone.model.parameters[place].value(own.chi[place]))
        left.append(own.residual)
    before = systematic(hypotheses.evidence, fit.residual)
    return values, 1 - systematic(hypotheses.evidence, np.concatenate(left)) / max(before, 1e-12)
