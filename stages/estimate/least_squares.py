"""Least squares on the centre-line, which also says how certain each parameter is.

Of random strings the best are refined side by side on a widening horizon (`inference.search`); outliers count less. The
intervals are those of a jackknife over blocks of time (`inference.covariance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.artifacts import Estimate, Observation
from stringcast.stages.common import Progress
from stringcast.stages.estimate.matching import Matching, Target, matching_rate, targets
from stringcast.stages.estimate.result import (
    EDGE,
    Candidates,
    Interval,
    correlated,
    estimate_of,
    start_chi,
    undetermined,
)
from stringcast.stages.inference.covariance import Covariance, covariance
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import discretisation_error
from stringcast.stages.inference.search import refined, screened, searched, with_initial_states
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import values_of

WIDE = 0.3  # an interval this wide in chi determines nothing
MISFIT = 1.5  # times the points' own uncertainty: a residual beyond that is more than noise
DRAWS = 400  # strings that stand for all that are possible


def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    manipulation: Annotated[int, Field(ge=1)],
    starts: Annotated[int, Field(ge=1)],
    screening: Annotated[int, Field(ge=1)],
    iterations: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Parameters of least squared distance to the measured points, with 95 % intervals.

    screening: random candidates from which the best `starts` are refined, beside the previous
    estimate; in them, effects beyond the paper's are as they are known. iterations: of each start at most, before all
    of the trials is fitted. `manipulation` plays no part.
    The intervals are of the model's parameters under noise; what the model itself lacks they
    cannot cover, and the sentence says so where the residual is more than noise.
    """
    goals = targets(model, observations, matching)
    before = start_chi(model.parameters, previous)
    drawn = np.random.default_rng([seed, manipulation]).uniform(0, 1, (screening, len(before)))
    # What is known of effects beyond the paper's is not drawn from all its range, where a dry friction, say, asks for a
    # hundred times as many steps; it is refined.
    known = [i for i, name in enumerate(model.names) if "." in name and name in model.known]
    drawn[:, known] = before[known]
    tried = np.concatenate([before[None], drawn])
    given = Likelihood(Data(tuple(goal.case for goal in goals)), model)
    found = searched(given, screened(given, tried, starts), iterations, progress)
    likelihood, best = refined(given, found)
    goals = [replace(goal, case=trial) for goal, trial in zip(goals, likelihood.data.trials, strict=True)]
    tried = np.concatenate([tried, best[None]])
    search = Candidates("least squares", tried, matching_rate(goals, values_of(model.parameters, tried)))
    sure = covariance(likelihood, best)
    interval = _interval(model, best, sure, likelihood)
    return estimate_of(goals, before, best, search, interval, _draws(best, sure, seed))


def posterior_samples(goals: Sequence[Target], chi: np.ndarray, seed: int) -> np.ndarray:
    """Strings that the trials leave possible about a solution chi (P,), whichever way it was found: (DRAWS, P).

    Normal, with the covariance of least squares there; what would leave its range stops at its end.
    """
    likelihood = Likelihood(Data(tuple(goal.case for goal in goals)), goals[0].case.model)
    return _draws(chi, covariance(with_initial_states(likelihood, chi), chi), seed)


def _interval(model: Model, best: np.ndarray, sure: Covariance, likelihood: Likelihood) -> Interval:
    """95 % intervals about the solution (P,), what the data cannot determine, and what the intervals do not cover."""
    low, high = np.clip(best - sure.reach, 0, 1), np.clip(best + sure.reach, 0, 1)
    determined = (high - low < WIDE) & (best > EDGE) & (best < 1 - EDGE)
    said = undetermined(model.parameters, determined, "This data determines every parameter.")
    said += correlated(model.parameters, determined, sure.correlation)
    if max(likelihood.scale) >= MISFIT:
        said += (
            f" The residual is up to {max(likelihood.scale):.1f} times what the points' uncertainty explains: the "
            "model lacks something, and the intervals do not cover that."
        )
    string, error = likelihood.model.string, discretisation_error(likelihood, best)
    pairs = zip(likelihood.scale, likelihood.data.trials, strict=True)
    noise = np.sqrt(2) * np.median([scale * np.median(trial.sigma) for scale, trial in pairs])
    if error > noise:
        finer = f"string.points={2 * string.points - 1} string.largest_step={string.largest_step / 2:.2g}"
        said += (
            f" A far finer mesh would put the string {1e3 * error:.1f} mm elsewhere, root mean square, beside "
            f"{1e3 * noise:.1f} mm of noise: parameters make up for that in these motions, not in others. Finer: "
            f"{finer}."
        )
    return Interval(low, high, determined, said)


def _draws(chi: np.ndarray, sure: Covariance, seed: int) -> np.ndarray:
    """Draws of the parameters (DRAWS, P) about the solution chi (P,), within their ranges."""
    return np.clip(np.random.default_rng([seed, DRAWS]).multivariate_normal(chi, sure.matrix, DRAWS), 0, 1)
