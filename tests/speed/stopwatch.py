"""Fair timing on a shared, noisy machine: contenders take turns, and their ratios
count.

What one thread does is timed in the processor time of that thread, so that a neighbour
who takes the core for a while does not count; what several threads do, by the wall
clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import pandas as pd

Clock = Callable[[], float]


def seconds(call: Callable[[], object], clock: Clock = time.thread_time) -> float:
    """Seconds that one call takes."""
    begun = clock()
    call()
    return clock() - begun


def in_turns(
    calls: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Clock = time.thread_time,
) -> pd.DataFrame:
    """Seconds of each call (columns) in each round; one round more, before, is not
    counted.
    """
    for call in calls.values():
        call()
    return pd.DataFrame(
        [
            {name: seconds(call, clock) for name, call in calls.items()}
            for _ in range(rounds)
        ]
    )
