"""Refine motions by CMA-ES on a smooth substitute for their hit probability.

Reference: N. Hansen, The CMA evolution strategy: a tutorial, arXiv 1604.00772 (cmaes
package).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cmaes import CMA

from stringcast.stages.generate.curves import (
    INTERVALS,
    Curves,
    control_points,
    whole_ticks,
)
from stringcast.stages.generate.generate import arm_faults
from stringcast.stages.generate.hit_probability import CastTask, predict_outcome
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.arm import Arm

POPULATION_SIZE = 12  # candidates in a generation of CMA-ES
INITIAL_STEP = 0.02  # as a share of each coordinate's range
# largest acceleration of a refined motion in units of alpha, within the arm's limits
MAX_STEP_RATIO = 3.0
# candidates drawn for each one simulated, because some are infeasible
SPARE_FACTOR = 2
INFEASIBLE_LOSS = 2.0  # above 1, the loss of a motion that never comes near


@dataclass(frozen=True)
class MotionSpace:
    """Motions as points (D,) with coordinates of order one.

    The coordinates are start angles and T as shares of their ranges, then the
    accelerations alpha_n of Eq. 2 as shares of alpha.

    Parameters
    ----------
    arm : the arm with its limits
    shortest, longest : range of T [s]
    alpha : limit of random accelerations [rad/s^2]
    """

    arm: Arm
    shortest: float
    longest: float
    alpha: float

    @property
    def bounds(self) -> np.ndarray:
        """Least and greatest coordinates of the space, (D, 2)."""
        joints = len(self.arm.links)
        shares = [[0.0, 1.0]] * (joints + 1)
        accelerations = [[-MAX_STEP_RATIO, MAX_STEP_RATIO]] * (joints * (INTERVALS - 1))
        return np.array(shares + accelerations)

    def points(self, curves: Curves) -> np.ndarray:
        """Convert motions to points (B, D)."""
        lowest, highest = np.array(self.arm.lowest), np.array(self.arm.highest)
        start = (curves.start - lowest) / (highest - lowest)
        span = max(self.longest - self.shortest, self.arm.tick)
        duration = (curves.duration - self.shortest) / span
        scaled = curves.control[..., 1:-1] * INTERVALS / curves.duration[:, None, None]
        acceleration = (scaled / self.alpha).reshape(len(start), -1)
        return np.concatenate([start, duration[:, None], acceleration], axis=1)

    def curves(self, points: np.ndarray) -> Curves:
        """Convert points (B, D) to motions."""
        lowest, highest = np.array(self.arm.lowest), np.array(self.arm.highest)
        joints = len(lowest)
        start = lowest + points[:, :joints] * (highest - lowest)
        duration = self.shortest + points[:, joints] * (self.longest - self.shortest)
        duration = whole_ticks(duration, self.arm.tick)
        shares = points[:, joints + 1 :].reshape(len(points), joints, INTERVALS - 1)
        return Curves(start, duration, control_points(shares * self.alpha, duration))


def refine_motions(
    task: CastTask,
    space: MotionSpace,
    starts: Curves,
    samples: UncertaintySamples,
    iterations: int,
    seed: int,
) -> Curves:
    """Refine each start and return the best motion found from it.

    All searches use the same samples, so that chance does not decide between them. They
    step together: one batch of simulations serves them all. The worse half of the
    searches is dropped in turn, until one is left.
    """
    points = space.points(starts)
    best = points.copy()
    best_closeness = predict_outcome(task, starts, samples).closeness
    searches = []
    for start, mean in enumerate(np.clip(points, *space.bounds.T)):
        search = CMA(
            mean=mean,
            sigma=INITIAL_STEP,
            bounds=space.bounds,
            population_size=POPULATION_SIZE,
            seed=(seed + start) % 2**32,  # NumPy takes no larger seed
        )
        searches.append(search)
    active = np.arange(len(searches))
    rounds = len(searches).bit_length()
    for steps in np.array_split(np.arange(iterations), rounds):
        for _ in steps:
            candidates = [
                _draw_candidates(task, space, searches[number]) for number in active
            ]
            feasible = np.concatenate([drawn[:count] for drawn, count in candidates])
            outcome = predict_outcome(task, space.curves(feasible), samples)
            first = 0
            for number, (drawn, count) in zip(active, candidates, strict=True):
                closeness = outcome.closeness[first : first + count]
                first += count
                loss = np.full(len(drawn), INFEASIBLE_LOSS)
                loss[:count] = 1 - closeness
                searches[number].tell(list(zip(drawn, loss, strict=True)))
                if count and closeness.max() > best_closeness[number]:
                    best[number] = drawn[np.argmax(closeness)]
                    best_closeness[number] = closeness.max()
        # drop the worse half of the searches
        ranked = active[np.argsort(-best_closeness[active], kind="stable")]
        active = ranked[: -(-len(ranked) // 2)]
    return space.curves(best)


def _draw_candidates(
    task: CastTask, space: MotionSpace, search: CMA
) -> tuple[np.ndarray, int]:
    """Draw points (POPULATION_SIZE, D), feasible ones first, and count the feasible."""
    points = np.stack([search.ask() for _ in range(SPARE_FACTOR * POPULATION_SIZE)])
    curves = space.curves(points)
    sampled = curves.sample(space.arm.tick, float(curves.duration.max()))
    feasible = arm_faults(space.arm, task.obstacles, *sampled) == ""
    order = np.argsort(~feasible, kind="stable")[:POPULATION_SIZE]
    return points[order], int(feasible[order].sum())
