"""A race of random motions: all on a few samples, the nearest ones on more, and so on.

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

# of the accelerations: a gentle cast is predicted better
SPEED_SHARES = (1.0, 0.5, 0.25)
MIN_CHANGE_SHARE = 0.03  # of a change of the last motion
BATCH_SIZE = 128  # movements whose limits are checked together
MAX_BATCHES = 100  # of one kind
FIRST_SAMPLES = 3  # with which the race begins
SAMPLE_GROWTH = 3  # factor from one round to the next ...
MOTION_REDUCTION = 4  # ... in which so many times fewer motions remain


def sample_feasible_motions(
    task: CastTask,
    space: MotionSpace,
    previous: Motion | None,
    fraction: float,
    count: int,
    rng: np.random.Generator,
) -> Curves:
    """Sample random movements that the arm can make.

    A quarter of them are changes of the previous motion, if there is one. There are
    fewer than `count` where hardly any movement is possible.
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
        kinds.append(partial(draw_between, arm, rng, last, changed))
    for draw in kinds:
        found = 0
        for _ in range(MAX_BATCHES):
            if found * len(kinds) >= count:
                break
            batch = feasible_motions(task, draw())
            found += len(batch.duration)
            feasible.append(batch)
    return join_curves(feasible)


def draw_between(
    arm: Arm, rng: np.random.Generator, last: Curves, draw: Callable[[], Curves]
) -> Curves:
    """Draw changes of the last motion of all sizes, from slight ones to whole ones.

    The share of a change is between MIN_CHANGE_SHARE and 1, uniform in its logarithm.
    """
    changed = draw()
    share = np.exp(rng.uniform(np.log(MIN_CHANGE_SHARE), 0, len(changed.duration)))
    duration = last.duration + share * (changed.duration - last.duration)
    control = last.control + share[:, None, None] * (changed.control - last.control)
    return Curves(changed.start, whole_ticks(duration, arm.tick), control)


def feasible_motions(task: CastTask, curves: Curves) -> Curves:
    """Select the movements that keep every limit of the arm."""
    arm = task.model.arm
    angles, speeds = curves.sample(arm.tick, float(curves.duration.max()))
    faults = arm_faults(arm, task.obstacles, angles, speeds)
    return curves.select(np.flatnonzero(faults == ""))


def race_motions(task: CastTask, curves: Curves, samples: UncertaintySamples) -> Curves:
    """Rank movements on growing parts of the samples, and drop the worst each time.

    Returns those left after the round with all samples, the nearest first.
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
