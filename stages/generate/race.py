"""Random motions race: all on a few draws of what may be so, the nearer ones on more,
and so on.

Successive halving: Jamieson and Talwalkar 2016, Non-stochastic best arm identification,
AISTATS.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from stringcast.data.artifacts import Motion
from stringcast.stages.generate.curves import (
    Curves,
    first_curves,
    join_curves,
    next_curves,
)
from stringcast.stages.generate.generate import arm_faults, curves_from_motion
from stringcast.stages.generate.hit_probability import CastTask, predict_outcome
from stringcast.stages.generate.refine import MotionSpace
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples

# of the accelerations: a gentle cast is predicted better
SPEED_SHARES = (1.0, 0.5, 0.25)
BATCH_SIZE = 128  # movements whose limits are checked together
MAX_BATCHES = 100  # such batches of a kind at most
# draws that the race begins with; each round takes MORE times as many,
FIRST_SAMPLES = 3
SAMPLE_GROWTH = 3
MOTION_REDUCTION = 4  # for a share of 1 / FEWER of the motions


def sample_feasible_motions(
    task: CastTask,
    space: MotionSpace,
    previous: Motion | None,
    fraction: float,
    count: int,
    rng: np.random.Generator,
) -> Curves:
    """Random movements that the arm can make: anywhere, and a quarter of them near the
    last one.

    Fewer than `count` where hardly any is possible.
    """
    arm, durations, found = space.arm, (space.shortest, space.longest), []
    draw = [
        partial(first_curves, arm, rng, BATCH_SIZE, durations, space.alpha * share)
        for share in SPEED_SHARES
    ]
    if previous is not None:
        last = curves_from_motion(previous)
        found.append(feasible_motions(task, last))
        draw.append(
            partial(
                next_curves,
                arm,
                rng,
                BATCH_SIZE,
                durations,
                space.alpha,
                last,
                fraction,
            )
        )
    for kind in draw:
        own: list[Curves] = []
        while (
            sum(len(c.duration) for c in own) * len(draw) < count
            and len(own) < MAX_BATCHES
        ):
            own.append(feasible_motions(task, kind()))
        found += own
    return join_curves(found)


def feasible_motions(task: CastTask, curves: Curves) -> Curves:
    """The movements that keep every limit of the arm."""
    angles, speeds = curves.sample(task.model.arm.tick, float(curves.duration.max()))
    return curves.select(
        np.flatnonzero(arm_faults(task.model.arm, task.obstacles, angles, speeds) == "")
    )


def race_motions(task: CastTask, curves: Curves, draws: UncertaintySamples) -> Curves:
    """The movements that are left when all `draws` have been seen, the nearest first."""
    count = FIRST_SAMPLES
    while True:
        closeness = predict_outcome(task, curves, draws.select(slice(count))).closeness
        ranked = curves.select(np.argsort(-closeness, kind="stable"))
        if count >= len(draws):
            return ranked
        curves, count = (
            ranked.select(np.arange(-(-len(closeness) // MOTION_REDUCTION))),
            count * SAMPLE_GROWTH,
        )
