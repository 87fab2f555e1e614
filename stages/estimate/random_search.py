"""The paper's estimation: random search on the matching rate, narrowing as it goes
(IV-A).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.artifacts import Estimate, Observation
from stringcast.stages.common import Progress
from stringcast.stages.estimate.least_squares import posterior_samples
from stringcast.stages.estimate.matching import (
    Matching,
    matching_rate,
    matching_targets,
)
from stringcast.stages.estimate.result import (
    Candidates,
    build_estimate,
    insensitive_parameters,
    start_chi,
)
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values


def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    manipulation: Annotated[int, Field(ge=1)],
    candidates: Annotated[int, Field(ge=1)],
    chi_0: Annotated[float, Field(gt=0, le=1)],
    beta: Annotated[float, Field(gt=0, le=1)],
    batch: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Parameters with the highest matching rate E.

    Candidate m is chi_best + chi_0 / M beta^m RAND(-1, 1), clipped to [0, 1] (Eq. 4),
    each parameter with a random number of its own; M is `manipulation`, from 1.
    chi_best begins with the previous manipulation's estimate and is then the best so
    far: the narrowing by beta^m would make no sense around a point that stays.
    Candidates are drawn `batch` at a time from the same chi_best, so that they fill the
    machine: 1 is one by one, and as many as `candidates` is Eq. 4 to the letter, where
    chi_best is the previous manipulation's estimate.
    """
    goals = matching_targets(model, observations, matching)
    before = start_chi(model.parameters, previous)
    rng = np.random.default_rng(seed)
    chi, rate = (
        before[None],
        matching_rate(goals, parameter_values(model.parameters, before[None])),
    )
    best, best_rate = before, rate[0]
    for first in range(1, candidates, batch):
        m = np.arange(first, min(first + batch, candidates))
        step = chi_0 / manipulation * beta**m
        drawn = np.clip(
            best + step[:, None] * rng.uniform(-1, 1, (len(m), len(before))), 0, 1
        )
        scores = matching_rate(goals, parameter_values(model.parameters, drawn))
        progress((m[-1] + 1) / candidates)
        chi, rate = np.concatenate([chi, drawn]), np.concatenate([rate, scores])
        if np.nanmax(scores, initial=-np.inf) > np.nan_to_num(best_rate, nan=-np.inf):
            best, best_rate = drawn[int(np.nanargmax(scores))], np.nanmax(scores)
    search = Candidates("random search", chi, rate)
    return build_estimate(
        goals,
        before,
        best,
        search,
        insensitive_parameters(goals, search),
        posterior_samples(goals, best, seed),
    )
