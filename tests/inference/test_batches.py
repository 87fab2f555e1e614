"""Batches of trials that are simulated together."""

from itertools import chain, product

import numpy as np
import pytest
from numba import get_num_threads

from stringcast.stages.inference import batch
from stringcast.stages.model.engine.kernel_codegen import LANES


def plan_cost(batches, seconds, candidates):
    """Compute the simulated time that batches of trials cost [s]."""
    loads = candidates / LANES / get_num_threads()
    total = 0.0
    for members in batches:
        cost = batch.SEPARATE_HANDS_COST if len(members) > 1 else 1.0
        longest = max(seconds[k] for k in members)
        total += batch.BATCH_OVERHEAD_S + cost * np.ceil(len(members) * loads) * longest
    return total


def all_plans(seconds):
    """Yield every way to cut the trials into batches, ordered by their length."""
    order = np.argsort(seconds)
    for cuts in product([False, True], repeat=len(order) - 1):
        places = np.flatnonzero(cuts) + 1
        yield [part.tolist() for part in np.split(order, places)]


@pytest.mark.parametrize("candidates", [1, 6, 40])
def test_planned_batches_have_the_least_cost_of_all_plans(candidates):
    seconds = np.random.default_rng(candidates).uniform(0.3, 1.5, 7).tolist()
    planned = batch._plan_batches(seconds, candidates)
    costs = [plan_cost(plan, seconds, candidates) for plan in all_plans(seconds)]
    assert plan_cost(planned, seconds, candidates) == pytest.approx(min(costs))
    assert len(costs) == 64


def test_many_long_trials_are_simulated_in_batches_of_bounded_memory():
    """Short trials share a batch; of many long ones no batch exceeds the bound."""
    assert len(batch._plan_batches([1.0] * 4, 1)) == 1
    seconds = [10.0] * 50
    batches = batch._plan_batches(seconds, 64)
    assert sorted(chain(*batches)) == list(range(50))
    assert max(len(members) for members in batches) * 64 * 10.0 <= batch.MAX_BATCH_S
