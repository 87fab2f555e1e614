"""Random motions race: all on a few draws of what may be so, the nearer ones on more,
and so on.

Successive halving: Jamieson and Talwalkar 2016, Non-stochastic best arm identification,
AISTATS.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from stringcast.data.artifacts import Motion
from stringcast.stages.generate.chance import Task, outcome
from stringcast.stages.generate.curves import Curves, first_curves, joined, next_curves
from stringcast.stages.generate.draws import Draws
from stringcast.stages.generate.generate import arm_faults, curves_of
from stringcast.stages.generate.refine import Space

GENTLER = (1.0, 0.5, 0.25)  # of the accelerations: a gentle cast is predicted better
AT_ONCE = 128  # movements whose limits are checked together
TRIES = 100  # such batches of a kind at most
BEGIN = 3  # draws that the race begins with; each round takes MORE times as many,
MORE = 3
FEWER = 4  # for a share of 1 / FEWER of the motions


def entrants(
    task: Task,
    space: Space,
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
        partial(first_curves, arm, rng, AT_ONCE, durations, space.alpha * share)
        for share in GENTLER
    ]
    if previous is not None:
        last = curves_of(previous)
        found.append(possible(task, last))
        draw.append(
            partial(
                next_curves, arm, rng, AT_ONCE, durations, space.alpha, last, fraction
            )
        )
    for kind in draw:
        own: list[Curves] = []
        while (
            sum(len(c.duration) for c in own) * len(draw) < count and len(own) < TRIES
        ):
            own.append(possible(task, kind()))
        found += own
    return joined(found)


def possible(task: Task, curves: Curves) -> Curves:
    """The movements that keep every limit of the arm."""
    angles, speeds = curves.sampled(task.model.arm.tick, float(curves.duration.max()))
    return curves.only(
        np.flatnonzero(arm_faults(task.model.arm, task.obstacles, angles, speeds) == "")
    )


def race(task: Task, curves: Curves, draws: Draws) -> Curves:
    """The movements that are left when all `draws` have been seen, the nearest first."""
    count = BEGIN
    while True:
        closeness = outcome(task, curves, draws.only(slice(count))).closeness
        ranked = curves.only(np.argsort(-closeness, kind="stable"))
        if count >= len(draws):
            return ranked
        curves, count = (
            ranked.only(np.arange(-(-len(closeness) // FEWER))),
            count * MORE,
        )
