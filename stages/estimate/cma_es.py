"""CMA-ES on the matching rate, for when the paper's random search is too slow to
converge.

Reference: N. Hansen, The CMA evolution strategy: a tutorial, arXiv 1604.00772 (cmaes
package).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from cmaes import CMA
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
    sigma: Annotated[float, Field(gt=0, le=1)],
    population: Annotated[int, Field(ge=4)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Parameters with the highest E. sigma: first step in chi, divided by
    `manipulation`.

    A search that has come to rest begins again somewhere else, until `candidates` are
    spent.
    """
    goals = matching_targets(model, observations, matching)
    before = start_chi(model.parameters, previous)
    # about a point on a bound half of what is drawn lies beyond
    middle = (
        np.clip(before, 0.05, 0.95)
        if previous is not None
        else np.full(len(before), 0.5)
    )
    bounds = np.tile([0.0, 1.0], (len(before), 1))
    settings = {
        "sigma": sigma / manipulation,
        "bounds": bounds,
        "population_size": population,
    }
    search, rng = CMA(mean=middle, seed=seed, **settings), np.random.default_rng(seed)
    tried, rates = (
        [before[None]],
        [matching_rate(goals, parameter_values(model.parameters, before[None]))],
    )
    rounds = max((candidates - 1) // population, 1)
    for number in range(rounds):
        if search.should_stop():
            search = CMA(
                mean=rng.uniform(0, 1, len(before)),
                seed=int(rng.integers(2**31)),
                **settings,
            )
        chi = np.stack([search.ask() for _ in range(population)])
        rate = matching_rate(goals, parameter_values(model.parameters, chi))
        # E is at least 0: a run that was rejected is worse than any other
        search.tell(
            [(c, -r if np.isfinite(r) else 1.0) for c, r in zip(chi, rate, strict=True)]
        )
        tried.append(chi)
        rates.append(rate)
        progress((number + 1) / rounds)
    found = Candidates("CMA-ES", np.concatenate(tried), np.concatenate(rates))
    best = found.chi[found.best_index]
    return build_estimate(
        goals,
        before,
        best,
        found,
        insensitive_parameters(goals, found),
        posterior_samples(goals, best, seed),
    )
