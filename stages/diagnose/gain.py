"""What the extension gains on trials that neither model has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from data.artifacts import HELD_OUT, Observation
from stages.diagnose.choose import Causes, Court, noisiness
from stages.diagnose.prepare import Ground
from stages.estimate.forward import Case
from stages.estimate.matching import Matching, targets
from stages.estimate.result import values_of
from stages.model.model import Model

FRAMES = 20  # of a trial, from which E is counted


@dataclass(frozen=True)
class Unseen:
    """A trial that neither model was fitted to. chi: (P,) of the base and of the extended model."""

    number: int
    chi: tuple[np.ndarray, np.ndarray]


def unseen(court: Court, causes: Causes, kept: Sequence[int], rest: Sequence[int]) -> list[Unseen]:
    """The trials that were set aside; where there are none, each in turn, left out of both fits."""
    if rest:
        return [Unseen(k, (court.tried[frozenset()].chi, court.tried[causes].chi)) for k in rest]
    both = (court.held(frozenset()), court.held(causes))
    return [Unseen(k, (both[0].chi[i], both[1].chi[i])) for i, k in enumerate(kept)]


def held_out_table(
    court: Court,
    ground: Ground,
    causes: Causes,
    trials: Sequence[Unseen],
    observations: Sequence[Observation],
    matching: Matching,
) -> pd.DataFrame:
    """Table HELD_OUT. observations: of all trials of the ground's evidence."""
    models = [court.tried[key].theory.model for key in (frozenset[str](), causes)]
    chance = noisiness(court.evidence, court.tried[causes])
    rows = []
    for trial in trials:
        own = replace(ground.evidence, segments=court.evidence.segments).only([trial.number])
        case, floor = own.cases[0], ground.floor[ground.evidence.trial == trial.number]
        off = [own.residuals(m, chi[None])[0] for m, chi in zip(models, trial.chi, strict=True)]
        row = {"trial": case.name, "noise_floor": float(np.sqrt(2 * np.mean(floor**2)))}
        row["log_likelihood_difference"] = float(np.sum(off[0] ** 2) - np.sum(off[1] ** 2)) / 2 / chance
        for name, residual, model, chi in zip(("base", "extended"), off, models, trial.chi, strict=True):
            row |= _measures(case, residual, name)
            finest = model.divided(court.evidence.segments[-1])
            row[f"E_{name}"] = _rate(finest, chi, case, observations[trial.number], matching)
        rows.append(row)
    return HELD_OUT.check(pd.DataFrame(rows))


def _measures(case: Case, residual: np.ndarray, name: str) -> dict[str, float]:
    """Root mean squares of a trial's residual over sigma, of all of it and of the tip [m]."""
    off = np.linalg.norm(residual.reshape(-1, 2), axis=1) * case.sigma
    tip = case.s > case.s.max() - 1e-3
    parts = {"rms": off, "tip_rms": off[tip]}
    return {f"{what}_{name}": float(np.sqrt(np.mean(part**2))) for what, part in parts.items()}


def _rate(model: Model, chi: np.ndarray, case: Case, observation: Observation, matching: Matching) -> float:
    """E of a trial, from the state in which the case begins."""
    goal = targets(model, [thinned(observation)], matching)[0]
    goal = replace(goal, case=replace(goal.case, initial=case.initial))
    return float(np.mean(goal.per_frame(values_of(model.parameters, chi[None]))[0]))


def thinned(observation: Observation) -> Observation:
    """With some FRAMES frames, which are too far apart to tell how it begins: that is not asked of them."""
    times = np.unique(observation.points["t"])
    kept = times[:: max(len(times) // FRAMES, 1)]
    return replace(observation, points=observation.points[observation.points["t"].isin(kept)], moving=False)


def extended_settings(model: Model, court: Court, causes: Causes) -> dict[str, object]:
    """The extended model as settings that other stages take: what is at work, and what is known of it."""
    fit = court.tried[causes]
    segments = court.evidence.segments[-1]
    fine = fit.theory.model.string
    kind = type(fine.integrator)
    string: dict[str, object] = {"points": segments + 1, "tip_cell": fine.tip_cell, "grasp_cell": fine.grasp_cell}
    string |= {"largest_step": fine.largest_step}
    integrator = {"_target_": f"{kind.__module__}.{kind.__qualname__}"}
    known: dict[str, object] = {name: float(f"{value:.8g}") for name, value in fit.values.items()}
    for name, (low, high) in model.measured.items():
        known[name] = {"value": float(np.clip(fit.values[name], low, high)), "low": low, "high": high}
    at_work = [e.name for e in model.effects if not e.parameters or "." in e.qualified(e.parameters[0])]
    return {
        "effects": sorted({*at_work, *causes} - {"gravity"}),
        "string": {**string, "integrator": integrator},
        "known": known,
    }
