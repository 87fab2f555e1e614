"""The ladder of meshes, each of half as many segments and steps twice as long, and how
far one is from its limit.

A coarser string costs a quarter, and is near enough to say which start is on the right
way: of 24 sets of casts all end in the same minimum, searched with 20 points or with
11. Parameters are the material's, so that they mean the same on every rung.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

MIN_SEGMENTS = 10  # segments: with fewer the string's second bend is lost
# times as many segments and as short steps stand for the limit: of second order, 1/16
# of the error is left
REFERENCE_REFINEMENT = 4


def mesh_ladder(likelihood: Likelihood) -> list[Likelihood]:
    """The same trials of coarser and coarser strings, the given one first."""
    found = [likelihood]
    while found[-1].model.string.points - 1 >= 2 * MIN_SEGMENTS - 1:
        found.append(_likelihood_on_mesh(likelihood, 0.5 ** len(found)))
    return found


def discretisation_error(likelihood: Likelihood, chi: np.ndarray) -> float:
    """How far the string of parameters (P,) is from one of a far finer mesh, root mean
    square of the measured points [m]; NaN where that cannot be simulated.
    """
    values = parameter_values(likelihood.parameters, chi[None])
    here, there = (
        _simulated_points(some, values)
        for some in (likelihood, _likelihood_on_mesh(likelihood, REFERENCE_REFINEMENT))
    )
    return float(np.sqrt(np.mean(np.sum((here - there) ** 2, axis=-1))))


def _simulated_points(likelihood: Likelihood, values: np.ndarray) -> np.ndarray:
    """Where one candidate (1, P) is at the measured places of all trials, (N, 2) [m]."""
    trials = likelihood.data.trials
    seen = simulate_trials(likelihood.model, trials, values)
    return np.concatenate(
        [t.sample_at_points(points)[0] for t, points in zip(trials, seen, strict=True)]
    )


def refine_mesh(
    model: Model, trials: Sequence[PreparedTrial], times: float
) -> tuple[Model, tuple[PreparedTrial, ...]]:
    """A model, and trials, of a string in so many times the segments, in steps as much
    shorter.
    """
    string = model.string
    segments = round(times * (string.points - 1) + 1e-9)
    finer = replace(
        model,
        string=replace(
            string, points=segments + 1, largest_step=string.largest_step / times
        ),
    )
    return finer, tuple(replace(trial, model=finer) for trial in trials)


def _likelihood_on_mesh(likelihood: Likelihood, times: float) -> Likelihood:
    model, trials = refine_mesh(likelihood.model, likelihood.data.trials, times)
    return replace(likelihood.with_trials(trials), model=model)
