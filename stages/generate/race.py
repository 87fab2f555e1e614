"""Race random motions: all on a few samples, the nearest ones on more, and so on.

Successive halving: K. Jamieson and A. Talwalkar, Non-stochastic best arm identification
and hyperparameter optimization, AISTATS 2016.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from stringcast.data.artifacts import Motion
from stringcast.stages.generate.curves import (
    Curves,
    curves_from_motion,
    first_curves,
    join_curves,
    next_curves,
    whole_ticks,
)
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.generate.hit_probability import CastTask, predict_outcome
from stringcast.stages.generate.refine import MotionSpace
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.arm import Arm

# factors on the limit of accelerations; gentle casts are predicted better
SPEED_SHARES = (1.0, 0.5, 0.25)
MIN_CHANGE_SHARE = 0.03  # smallest factor on a change of the last motion
BATCH_SIZE = 128  # motions whose limits are checked together
MAX_BATCHES = 100  # for each way to draw motions
FIRST_SAMPLES = 3  # samples in the first round
SAMPLE_GROWTH = 3  # factor on the samples from one round to the next
MOTION_REDUCTION = 4  # factor by which the motions become fewer in a round


def sample_feasible_motions(
    task: CastTask,
    space: MotionSpace,
    previous: Motion | None,
    fraction: float,
    count: int,
    rng: np.random.Generator,
) -> Curves:
    """Sample random motions that the arm can make.

    A quarter of them are changes of the previous motion, if there is one. Fewer than
    `count` are returned if hardly any motion is feasible.
    """
    arm = space.arm
    durations = (space.shortest, space.longest)
    feasible: list[Curves] = []
    kinds = [
        partial(first_curves, arm, rng, BATCH_SIZE, durations, space.alpha * share)
        for share in SPEED_SHARES
    ]
    if previous is not None:
        last = curves_from_motion(previous)
        feasible.append(feasible_motions(task, last))
        change = (space.alpha, last, fraction)
        changed = partial(next_curves, arm, rng, BATCH_SIZE, durations, *change)
        kinds.append(partial(draw_scaled_changes, arm, rng, last, changed))
    for draw in kinds:
        found = 0
        for _ in range(MAX_BATCHES):
            if found * len(kinds) >= count:
                break
            batch = feasible_motions(task, draw())
            found += len(batch.duration)
            feasible.append(batch)
    return join_curves(feasible)


def draw_scaled_changes(
    arm: Arm, rng: np.random.Generator, last: Curves, draw: Callable[[], Curves]
) -> Curves:
    """Draw changes of the last motion, scaled down to all sizes.

    The factor is between MIN_CHANGE_SHARE and 1, uniform in its logarithm.
    """
    changed = draw()
    share = np.exp(rng.uniform(np.log(MIN_CHANGE_SHARE), 0, len(changed.duration)))
    duration = last.duration + share * (changed.duration - last.duration)
    control = last.control + share[:, None, None] * (changed.control - last.control)
    return Curves(changed.start, whole_ticks(duration, arm.tick), control)


def feasible_motions(task: CastTask, curves: Curves) -> Curves:
    """Select the motions that keep every limit of the arm."""
    arm = task.model.arm
    angles, speeds = curves.sample(arm.tick, float(curves.duration.max()))
    faults = arm_faults(arm, task.obstacles, angles, speeds)
    return curves.select(np.flatnonzero(faults == ""))


def race_motions(task: CastTask, curves: Curves, samples: UncertaintySamples) -> Curves:
    """Rank motions on growing parts of the samples, and drop the worst in each round.

    Returns the motions left after the round with all samples, nearest first.
    """
    count = FIRST_SAMPLES
    while True:
        outcome = predict_outcome(task, curves, samples.select(slice(count)))
        ranked = curves.select(np.argsort(-outcome.closeness, kind="stable"))
        if count >= len(samples):
            return ranked
        kept = -(-len(ranked.duration) // MOTION_REDUCTION)
        curves = ranked.select(slice(kept))
        count *= SAMPLE_GROWTH
