"""What the extension gains on trials that neither model has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from data.artifacts import HELD_OUT, Observation
from stages.diagnose.choose import Causes, Court, noisiness
from stages.diagnose.compare import HeldOut
from stages.diagnose.noise import parts
from stages.diagnose.prepare import Ground
from stages.estimate.matching import Matching, targets
from stages.estimate.result import values_of
from stages.model.model import Model

FRAMES = 20  # of a trial, from which E is counted


def held_out_table(
    court: Court, ground: Ground, causes: Causes, observations: Sequence[Observation], matching: Matching
) -> pd.DataFrame:
    """Table HELD_OUT: each trial predicted by both models fitted to the others."""
    both = [court.held(frozenset()), court.held(causes)]
    chance = noisiness(court.evidence, court.tried[causes])
    rows = []
    for number, case in enumerate(court.evidence.cases):
        own = court.evidence.trial == number
        off = [_metres(court, held, number) for held in both]
        tip = case.s > case.s.max() - 1e-3
        rms = [float(np.sqrt(np.mean(np.sum(each**2, axis=1)))) for each in off]
        tips = [float(np.sqrt(np.mean(np.sum(each[tip] ** 2, axis=1)))) for each in off]
        rates = [_rate(court, held, number, observations[number], matching) for held in both]
        row = {"trial": case.name, "rms_base": rms[0], "rms_extended": rms[1]}
        row |= {"noise_floor": float(np.sqrt(2 * np.mean(ground.floor[own] ** 2)))}
        row |= {"tip_rms_base": tips[0], "tip_rms_extended": tips[1], "E_base": rates[0], "E_extended": rates[1]}
        row |= {"log_likelihood_difference": float(both[0].costs[number] - both[1].costs[number]) / chance}
        rows.append(row)
    return HELD_OUT.check(pd.DataFrame(rows))


def _metres(court: Court, held: HeldOut, number: int) -> np.ndarray:
    """Residual of a trial, (n, 2) [m]."""
    return parts(court.evidence, held.residual)[number] * court.evidence.cases[number].sigma[:, None]


def _rate(court: Court, held: HeldOut, number: int, observation: Observation, matching: Matching) -> float:
    """E of a trial, with the parameters fitted to the others."""
    model = held.fit.theory.model
    finest = replace(model, string=replace(model.string, points=court.evidence.segments[-1] + 1))
    goal = targets(finest, [thinned(observation)], matching)[0]
    rates, _ = goal.per_frame(values_of(model.parameters, held.chi[number][None]))
    return float(np.mean(rates))


def thinned(observation: Observation) -> Observation:
    """With FRAMES frames at most."""
    times = np.unique(observation.points["t"])
    kept = times[:: max(len(times) // FRAMES, 1)]
    return replace(observation, points=observation.points[observation.points["t"].isin(kept)])


def extended_settings(model: Model, court: Court, causes: Causes) -> dict[str, object]:
    """The extended model as settings that other stages take: what is at work, and what is known of it."""
    fit = court.tried[causes]
    segments = court.evidence.segments[-1]
    fine = fit.theory.model.string
    kind = type(fine.integrator)
    string: dict[str, object] = {"points": segments + 1, "tip_cell": fine.tip_cell, "grasp_cell": fine.grasp_cell}
    string |= {"largest_step": fine.largest_step}
    integrator = {"_target_": f"{kind.__module__}.{kind.__qualname__}"}
    known = {name: float(f"{value:.8g}") for name, value in fit.values.items()}
    at_work = [e.name for e in model.effects if not e.parameters or "." in e.qualified(e.parameters[0])]
    return {
        "effects": sorted({*at_work, *causes} - {"gravity"}),
        "string": {**string, "integrator": integrator},
        "known": known,
    }
