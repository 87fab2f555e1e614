"""Least squares on the centre-line, which also says how certain each parameter is.

Of random strings the best are refined side by side on a widening horizon
(`inference.search`); outliers count less. The intervals are those of a jackknife over
blocks of time (`inference.covariance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.artifacts import Estimate, Observation
from stringcast.stages.common import Progress
from stringcast.stages.estimate.matching import (
    Matching,
    MatchingTarget,
    matching_rate,
    matching_targets,
)
from stringcast.stages.estimate.result import (
    BOUND_TOLERANCE,
    Candidates,
    Interval,
    build_estimate,
    describe_correlated,
    describe_undetermined,
    start_chi,
)
from stringcast.stages.inference.covariance import Covariance, parameter_covariance
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import discretisation_error
from stringcast.stages.inference.search import (
    refine_solution,
    screen_candidates,
    search_parameters,
    with_refined_initial_states,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

UNDETERMINED_WIDTH = 0.3  # an interval this wide in chi determines nothing
# times the points' own uncertainty: a residual beyond that is more than noise
MISFIT_RATIO = 1.5
POSTERIOR_DRAWS = 400  # strings that stand for all that are possible


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

    screening: random candidates from which the best `starts` are refined, beside the
    previous estimate; in them, effects beyond the paper's are as they are known.
    iterations: of each start at most, before all of the trials is fitted.
    `manipulation` plays no part. The intervals are of the model's parameters under
    noise; what the model itself lacks they cannot cover, and the sentence says so where
    the residual is more than noise.
    """
    goals = matching_targets(model, observations, matching)
    before = start_chi(model.parameters, previous)
    drawn = np.random.default_rng([seed, manipulation]).uniform(
        0, 1, (screening, len(before))
    )
    # What is known of effects beyond the paper's is not drawn from all its range, where
    # a dry friction, say, asks for a hundred times as many steps; it is refined.
    known = [
        i
        for i, name in enumerate(model.names)
        if "." in name and name in model.start_values
    ]
    drawn[:, known] = before[known]
    tried = np.concatenate([before[None], drawn])
    given = Likelihood(TrialData(tuple(goal.trial for goal in goals)), model)
    found = search_parameters(
        given, screen_candidates(given, tried, starts), iterations, progress
    )
    likelihood, best = refine_solution(given, found)
    goals = [
        replace(goal, trial=trial)
        for goal, trial in zip(goals, likelihood.data.trials, strict=True)
    ]
    tried = np.concatenate([tried, best[None]])
    search = Candidates(
        "least squares",
        tried,
        matching_rate(goals, parameter_values(model.parameters, tried)),
    )
    sure = parameter_covariance(likelihood, best)
    interval = _parameter_intervals(model, best, sure, likelihood)
    return build_estimate(
        goals, before, best, search, interval, _sample_posterior(best, sure, seed)
    )


def posterior_samples(
    goals: Sequence[MatchingTarget], chi: np.ndarray, seed: int
) -> np.ndarray:
    """Strings that the trials leave possible about a solution chi (P,), whichever way
    it was found: (DRAWS, P).

    Normal, with the covariance of least squares there; what would leave its range stops
    at its end.
    """
    likelihood = Likelihood(
        TrialData(tuple(goal.trial for goal in goals)), goals[0].trial.model
    )
    return _sample_posterior(
        chi,
        parameter_covariance(with_refined_initial_states(likelihood, chi), chi),
        seed,
    )


def _parameter_intervals(
    model: Model, best: np.ndarray, sure: Covariance, likelihood: Likelihood
) -> Interval:
    """95 % intervals about the solution (P,), what the data cannot determine, and what
    the intervals do not cover.
    """
    low, high = (
        np.clip(best - sure.half_width_95, 0, 1),
        np.clip(best + sure.half_width_95, 0, 1),
    )
    determined = (
        (high - low < UNDETERMINED_WIDTH)
        & (best > BOUND_TOLERANCE)
        & (best < 1 - BOUND_TOLERANCE)
    )
    said = describe_undetermined(
        model.parameters, determined, "This data determines every parameter."
    )
    said += describe_correlated(model.parameters, determined, sure.correlation)
    if max(likelihood.noise_scales) >= MISFIT_RATIO:
        said += (
            f" The residual is up to {max(likelihood.noise_scales):.1f} times what the points' uncertainty explains: the "
            "model lacks something, and the intervals do not cover that."
        )
    string, error = likelihood.model.string, discretisation_error(likelihood, best)
    pairs = zip(likelihood.noise_scales, likelihood.data.trials, strict=True)
    noise = np.sqrt(2) * np.median(
        [scale * np.median(trial.sigma) for scale, trial in pairs]
    )
    if error > noise:
        finer = f"string.points={2 * string.points - 1} string.largest_step={string.largest_step / 2:.2g}"
        said += (
            f" A far finer mesh would put the string {1e3 * error:.1f} mm elsewhere, root mean square, beside "
            f"{1e3 * noise:.1f} mm of noise: parameters make up for that in these motions, not in others. Finer: "
            f"{finer}."
        )
    return Interval(low, high, determined, said)


def _sample_posterior(chi: np.ndarray, sure: Covariance, seed: int) -> np.ndarray:
    """Draws of the parameters (DRAWS, P) about the solution chi (P,), within their
    ranges.
    """
    return np.clip(
        np.random.default_rng([seed, POSTERIOR_DRAWS]).multivariate_normal(
            chi, sure.matrix, POSTERIOR_DRAWS
        ),
        0,
        1,
    )
