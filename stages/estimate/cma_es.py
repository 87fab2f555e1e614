"""CMA-ES on the matching rate, where the paper's random search converges too slowly.

References
----------
Hansen, The CMA evolution strategy: a tutorial, arXiv 1604.00772 (cmaes package).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from cmaes import CMA
from pydantic import Field, PositiveInt

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import Progress
from stringcast.stages.estimate.matching import (
    Matching,
    matching_rate,
    matching_targets,
)
from stringcast.stages.estimate.result import (
    Candidates,
    build_search_estimate,
    start_chi,
)
from stringcast.stages.model.model import Model
from stringcast.stages.spec import declare_string_counts

# range of the first mean; around a mean at a bound, half of the draws lie outside
MEAN_RANGE = (0.05, 0.95)
REJECTED_COST = 1.0  # of a diverged run; others cost at most 0


@declare_string_counts(lambda given: {"candidates": given["candidates"]})
def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    cast_number: PositiveInt,
    candidates: PositiveInt,
    sigma: Annotated[float, Field(gt=0, le=1)],
    population: Annotated[int, Field(ge=4)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Search for the parameters with the highest matching rate E.

    After convergence the search restarts at random until `candidates` are used up.

    Parameters
    ----------
    previous
        Estimate of the last cast, where the search starts.
    cast_number
        Number of the cast, from 1.
    candidates
        Total number of candidates.
    sigma
        Initial step in chi, which is divided by `cast_number`.
    population
        Number of candidates in a generation.
    matching
        Settings of E.
    """
    targets = matching_targets(model, observations, matching)
    before = start_chi(model, previous)
    count = len(before)
    rng = np.random.default_rng(seed)
    bounds = np.tile([0.0, 1.0], (count, 1))
    step = sigma / cast_number

    def start_search(mean: np.ndarray, search_seed: int) -> CMA:
        return CMA(
            mean=mean,
            sigma=step,
            bounds=bounds,
            population_size=population,
            seed=search_seed,
        )

    mean = np.full(count, 0.5)
    if previous is not None:
        mean = np.clip(before, *MEAN_RANGE)
    search = start_search(mean, seed)
    tried, rates = [before[None]], [matching_rate(targets, before[None])]
    generations = max((candidates - 1) // population, 1)
    for number in range(generations):
        if search.should_stop():
            search = start_search(rng.uniform(0, 1, count), int(rng.integers(2**31)))
        chi = np.stack([search.ask() for _ in range(population)])
        rate = matching_rate(targets, chi)
        cost = np.where(np.isfinite(rate), -rate, REJECTED_COST)
        search.tell(list(zip(chi, cost.tolist(), strict=True)))
        tried.append(chi)
        rates.append(rate)
        progress((number + 1) / generations)
    tried_candidates = Candidates(
        "CMA-ES", np.concatenate(tried), np.concatenate(rates)
    )
    return build_search_estimate(targets, before, tried_candidates, seed)
