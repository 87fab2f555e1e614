"""Refine motions by CMA-ES on a smooth stand-in for their chance of hitting.

Reference: N. Hansen, The CMA evolution strategy: a tutorial, arXiv 1604.00772 (cmaes
package).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cmaes import CMA

from stringcast.stages.generate.curves import INTERVALS, Curves, whole_ticks
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.generate.hit_probability import CastTask, predict_outcome
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.arm import Arm

POPULATION_SIZE = 12  # candidates in a generation of CMA-ES
INITIAL_STEP = 0.02  # first step, as a share of each coordinate's range
# times alpha: accelerations that a refined motion may come to; the arm's limits hold
# anyway
MAX_STEP_RATIO = 3.0
# times as many are asked for as are simulated: some the arm cannot make
SPARE_FACTOR = 2


@dataclass(frozen=True)
class MotionSpace:
    """Movements as points (D,): start angles and T [s] as shares of their ranges, then
    the accelerations alpha_n of Eq. 2 as shares of alpha [rad/s^2].
    """

    arm: Arm
    shortest: float
    longest: float
    alpha: float

    @property
    def bounds(self) -> np.ndarray:
        """Least and greatest coordinates of the space, (D, 2)."""
        joints = len(self.arm.links)
        return np.array(
            [[0.0, 1.0]] * (joints + 1)
            + [[-MAX_STEP_RATIO, MAX_STEP_RATIO]] * (joints * (INTERVALS - 1))
        )

    def points(self, curves: Curves) -> np.ndarray:
        """Movements as points of the space, (B, D), within `bounds`."""
        lowest, highest = np.array(self.arm.lowest), np.array(self.arm.highest)
        start = (curves.start - lowest) / (highest - lowest)
        duration = (curves.duration - self.shortest) / max(
            self.longest - self.shortest, self.arm.tick
        )
        share = (
            curves.control[..., 1:-1]
            * INTERVALS
            / curves.duration[:, None, None]
            / self.alpha
        )
        return np.concatenate(
            [start, duration[:, None], share.reshape(len(start), -1)], axis=1
        )

    def curves(self, points: np.ndarray) -> Curves:
        """The movements that are points (B, D) of the space."""
        lowest, highest = np.array(self.arm.lowest), np.array(self.arm.highest)
        start, share, rest = np.split(points, [len(lowest), len(lowest) + 1], axis=1)
        duration = whole_ticks(
            self.shortest + share[:, 0] * (self.longest - self.shortest), self.arm.tick
        )
        control = np.zeros((len(points), len(lowest), INTERVALS + 1))
        acceleration = (
            rest.reshape(len(points), len(lowest), INTERVALS - 1) * self.alpha
        )
        control[..., 1:-1] = acceleration * duration[:, None, None] / INTERVALS
        return Curves(lowest + start * (highest - lowest), duration, control)


def refine_motions(
    task: CastTask,
    space: MotionSpace,
    starts: Curves,
    draws: UncertaintySamples,
    rounds: int,
    seed: int,
) -> Curves:
    """The best movement found from each start. All are tried on the same draws: chance
    does not decide between two.
    """
    points = space.points(starts)
    best, most = points.copy(), predict_outcome(task, starts, draws).closeness
    settings = {
        "sigma": INITIAL_STEP,
        "bounds": space.bounds,
        "population_size": POPULATION_SIZE,
    }
    inside = np.clip(points, *space.bounds.T)
    # NumPy takes no larger seed
    searches = [
        CMA(mean=point, seed=(seed + number) % 2**32, **settings)
        for number, point in enumerate(inside)
    ]
    for _ in range(rounds):
        asked = [_ask_points(task, space, search) for search in searches]
        tried = np.concatenate([point[:count] for point, count in asked])
        close = predict_outcome(task, space.curves(tried), draws).closeness
        parts = np.split(close, np.cumsum([count for _, count in asked])[:-1])
        for number, (search, (point, count), own) in enumerate(
            zip(searches, asked, parts, strict=True)
        ):
            # what is not allowed is worse than what never comes near
            value = np.concatenate([1 - own, np.full(len(point) - count, 2.0)])
            search.tell(list(zip(point, value, strict=True)))
            if count and own.max() > most[number]:
                best[number], most[number] = point[np.argmax(own)], own.max()
    return space.curves(best)


def _ask_points(
    task: CastTask, space: MotionSpace, search: CMA
) -> tuple[np.ndarray, int]:
    """Points (POPULATION, D) that the search asks for, those first that the arm can
    make, and how many these are.
    """
    points = np.stack([search.ask() for _ in range(SPARE_FACTOR * POPULATION_SIZE)])
    curves = space.curves(points)
    sampled = curves.sample(space.arm.tick, float(curves.duration.max()))
    fine = arm_faults(space.arm, task.obstacles, *sampled) == ""
    order = np.argsort(~fine, kind="stable")[:POPULATION_SIZE]
    return points[order], int(fine[order].sum())
