"""Estimate as in the paper: a narrowing random search on the matching rate (IV-A)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
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


@declare_string_counts(lambda given: {"candidates": given["candidates"]})
def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    cast_number: PositiveInt,
    candidates: PositiveInt,
    chi_0: Annotated[float, Field(gt=0, le=1)],
    beta: Annotated[float, Field(gt=0, le=1)],
    batch: PositiveInt,
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Search for the parameters with the highest matching rate E.

    Candidate m is chi_best + chi_0 / M beta^m RAND(-1, 1), clipped to [0, 1] (Eq. 4),
    with a random number for each parameter. chi_best is the best candidate so far; the
    narrowing by beta^m would be pointless around a fixed point.

    Parameters
    ----------
    previous
        Estimate of the last cast, where the search starts.
    cast_number
        Number M of the cast, from 1.
    candidates
        Number of candidates.
    chi_0, beta
        Initial range of the exponents, and the factor on it for each candidate.
    batch
        Number of candidates drawn from the same chi_best and simulated together. With
        1, chi_best is updated after each candidate; with `candidates`, never.
    matching
        Settings of E.
    """
    targets = matching_targets(model, observations, matching)
    before = start_chi(model, previous)
    rng = np.random.default_rng(seed)
    chi = before[None]
    rate = matching_rate(targets, chi)
    best, best_rate = before, np.nan_to_num(rate[0], nan=-np.inf)
    for first in range(1, candidates, batch):
        m = np.arange(first, min(first + batch, candidates))
        step = (chi_0 / cast_number * beta**m)[:, None]
        drawn = best + step * rng.uniform(-1, 1, (len(m), len(before)))
        drawn = np.clip(drawn, 0, 1)
        drawn_rate = matching_rate(targets, drawn)
        progress((m[-1] + 1) / candidates)
        chi = np.concatenate([chi, drawn])
        rate = np.concatenate([rate, drawn_rate])
        if np.nanmax(drawn_rate, initial=-np.inf) > best_rate:
            winner = int(np.nanargmax(drawn_rate))
            best, best_rate = drawn[winner], drawn_rate[winner]
    search = Candidates("random search", chi, rate)
    return build_search_estimate(targets, before, search, seed)
