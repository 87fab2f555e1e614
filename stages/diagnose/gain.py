"""What the extension gains on trials that neither model has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import HELD_OUT, Observation
from stringcast.stages.diagnose.beginning import begun
from stringcast.stages.diagnose.compare import AGAIN, without_each
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import fitted
from stringcast.stages.diagnose.hypotheses import Causes, Hypotheses
from stringcast.stages.diagnose.prepare import Ground
from stringcast.stages.diagnose.single_effects.document import wider
from stringcast.stages.diagnose.single_effects.predictions import distances, rate
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class Side:
    """One of the two models that are compared. evidence: all trials, with its numbers of segments. chi: (K, P), for
    each trial of the table from a fit that has not seen it. known: (P,) fitted to all that causes were chosen from."""

    model: Model
    evidence: Evidence
    chi: Sequence[np.ndarray]
    known: np.ndarray

    def residual(self, chi: np.ndarray, number: int) -> np.ndarray:
        """Of the trial of a number at chi (P,), over sigma, (n,)."""
        return self.evidence.only([number]).residuals(self.model, chi[None])[0]

    @property
    def finest(self) -> Model:
        """With the larger number of segments."""
        return self.model.divided(self.evidence.segments[-1])


def side(hypotheses: Hypotheses, ground: Ground, causes: Causes, rest: Sequence[int]) -> Side:
    """The model with these causes. rest: numbers of the trials set aside; without any, each of the kept is left out in
    turn. Trials that begin moving begin in the state that suits it."""
    fit = hypotheses.tried[causes]
    evidence = replace(ground.evidence, segments=hypotheses.evidence.segments)
    evidence = begun(evidence, fit.theory.model, fit.chi)
    chi = [fit.chi] * len(rest) if rest else list(hypotheses.held(causes).chi)
    return Side(fit.theory.model, evidence, chi, fit.chi)


def configured(ground: Ground, kept: Sequence[int], rest: Sequence[int]) -> Side:
    """The model with the mass points that are configured."""
    own = ground.configured
    evidence = replace(ground.evidence, segments=(own.theory.model.string.points - 1,))
    fit = fitted(evidence.only(kept), [own.theory], [own.chi], AGAIN)[0]
    chi = [fit.chi] * len(rest) if rest else [fits[0].chi for fits in without_each(evidence.only(kept), fit)]
    return Side(own.theory.model, replace(evidence, unsure=()), chi, fit.chi)


def held_out_table(
    base: Side,
    extended: Side,
    numbers: Sequence[int],
    floor: np.ndarray,
    chance: float,
    observations: Sequence[Observation],
    matching: Matching,
) -> pd.DataFrame:
    """Table HELD_OUT. numbers: of its trials among the observations. floor: noise of all residuals [m], (N,). chance:
    how much less the likelihood counts because noise goes on from frame to frame; see `noisiness`."""
    rows = []
    for place, number in enumerate(numbers):
        case, own = base.evidence.cases[number], floor[base.evidence.trial == number]
        off = [one.residual(one.chi[place], number) for one in (base, extended)]
        row = {"trial": case.name, "noise_floor": float(np.sqrt(2 * np.mean(own**2)))}
        row["log_likelihood_difference"] = float(np.sum(off[0] ** 2) - np.sum(off[1] ** 2)) / 2 / chance
        for name, residual, one in zip(("base", "extended"), off, (base, extended), strict=True):
            row |= distances(case, residual, name)
            begin = one.evidence.cases[number].initial
            row[f"E_{name}"] = rate(one.finest, one.chi[place], begin, observations[number], matching)
        row["rms_known"] = distances(case, extended.residual(extended.known, number), "known")["rms_known"]
        rows.append(row)
    return HELD_OUT.check(pd.DataFrame(rows))


def extended_settings(model: Model, hypotheses: Hypotheses, causes: Causes) -> dict[str, object]:
    """The extended model as settings that other stages take: what is at work, and what is known of it, by the last fit;
    with the mass points and steps that were enough to find it, for the other stages simulate many."""
    fit = hypotheses.sharp(causes).fit if causes else hypotheses.tried[causes]
    segments, fine = hypotheses.evidence.segments[-1], hypotheses.tried[causes].theory.model.string
    kind = type(fine.integrator)
    string: dict[str, object] = {"points": segments + 1, "tip_cell": fine.tip_cell, "grasp_cell": fine.grasp_cell}
    string |= {"largest_step": fine.largest_step, "ranges": wider(model.string, fine)}
    integrator = {"_target_": f"{kind.__module__}.{kind.__qualname__}".removeprefix("stringcast.")}
    known: dict[str, object] = {name: float(f"{value:.8g}") for name, value in fit.values.items()}
    for name, (low, high) in model.measured.items():
        known[name] = {"value": float(np.clip(fit.values[name], low, high)), "low": low, "high": high}
    at_work = [e.name for e in model.effects if not e.parameters or "." in e.qualified(e.parameters[0])]
    return {
        "effects": sorted({*at_work, *causes} - {"gravity"}),
        "string": {**string, "integrator": integrator},
        "known": known,
    }
