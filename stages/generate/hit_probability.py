"""How near each of many motions brings the tip to the target, for each of many draws of
what may be so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model

# strings simulated at once: what is handed on stays in memory that is used again
BATCH_SIZE = 256
# of the worth of a draw that touches nothing: of one that touches something at last
CONTACT_DISTANCE = 0.5


@dataclass(frozen=True)
class CastTask:
    """The task of a cast. obstacles: what the arm may not touch at all, and the string
    not before it hits.
    """

    model: Model
    target: Box
    obstacles: Sequence[Box]


@dataclass(frozen=True)
class CastOutcome:
    """Results of M motions under K draws.

    clear: (M, K) share of the movement until something touches an obstacle, 1 where
    nothing does. distance: (M, K) of the tip from the target's centre in half widths
    and half heights, the least until then; infinite where the simulation diverges. hit:
    (M, K) the tip enters the box until then, as `stages.hit_test` has it, and the arm
    touches nothing afterwards either.
    """

    distance: np.ndarray
    free_share: np.ndarray
    hit: np.ndarray

    @property
    def closeness(self) -> np.ndarray:
        """(M,) a smooth stand-in for the share of draws that hit: 1 / (1 + d^2) is 1 at
        the centre and 1/2 at the inscribed ellipse, and still tells far from farther.
        Of two that come as near, one that touches nothing is worth more, and one that
        touches something late.
        """
        worth = np.where(self.free_share == 1, 1, CONTACT_DISTANCE * self.free_share)
        return np.mean(worth / (1 + self.distance**2), axis=1)


def predict_outcome(
    task: CastTask, curves: Curves, draws: UncertaintySamples
) -> CastOutcome:
    """Simulate every motion under every draw. Movements of like duration run together:
    none waits long for another.
    """
    count = len(curves.duration)
    made = CastOutcome(
        *(np.empty((count, len(draws)), dtype=kind) for kind in (float, float, bool))
    )
    order = np.argsort(curves.duration, kind="stable")
    for some in np.array_split(order, min(-(-count * len(draws) // BATCH_SIZE), count)):
        part = _predict_batch(task, curves.select(some), draws)
        made.distance[some], made.free_share[some], made.hit[some] = (
            part.distance,
            part.free_share,
            part.hit,
        )
    return made


def simulate_motions(
    model: Model, curves: Curves, draws: UncertaintySamples
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (M K, T, J) [rad] and strings (M K, T, n, 2) [m] at the ticks; each
    motion under all draws in turn.

    What a simulation is off grows along the string to what it is at the tip.
    """
    tick, until = model.arm.tick, float(curves.duration.max())
    angles, speeds = (
        each.repeat(len(draws), axis=0) for each in curves.sample(tick, until)
    )
    every = draws.select(np.tile(np.arange(len(draws)), len(curves.duration)))
    more = 1 + every.amplitude[:, None]
    motion = JointMotion(
        0.0, tick, angles[:, :1] + more * (angles - angles[:, :1]), more * speeds
    )
    points = model.simulate_string(
        motion, every.values, np.arange(angles.shape[1]) * tick
    ).points
    along = model.string.arc_lengths() / model.string.length
    points += along[:, None] * every.tip_error[:, None, None]
    return motion.angles, points


def _predict_batch(
    task: CastTask, curves: Curves, draws: UncertaintySamples
) -> CastOutcome:
    """All at once."""
    angles, points = simulate_motions(task.model, curves, draws)
    shape = (len(curves.duration), len(draws))
    tick, end = task.model.arm.tick, (curves.duration[:, None] - draws.lag).ravel()
    moving = np.arange(points.shape[1]) * tick <= end[:, None] + 1e-9
    way = midpoint_tip_path(points[:, :, -1])
    finite = np.isfinite(way).all(axis=(1, 2))
    arm, string = (each & moving for each in _contact_ticks(task, angles, points))
    before = ~np.logical_or.accumulate(arm | string, axis=1)
    clear = (before & moving).sum(axis=1) / moving.sum(axis=1)
    # pieces of the way, two to a tick
    counts = (before & moving)[:, 1:].repeat(2, axis=1)
    # from the centre to each piece of the way, in half widths and heights
    target = task.target
    scaled = (way - [target.x, target.y]) / [target.w / 2, target.h / 2]
    start, piece = scaled[:, :-1], np.diff(scaled, axis=1)
    square = np.maximum(piece[..., 0] ** 2 + piece[..., 1] ** 2, 1e-300)
    share = np.clip(
        -(start[..., 0] * piece[..., 0] + start[..., 1] * piece[..., 1]) / square, 0, 1
    )
    nearest = np.hypot(*np.moveaxis(start + share[..., None] * piece, -1, 0))
    away = np.where(counts, nearest, np.inf).min(axis=1)
    hit = (
        (target.is_crossed_by(way[:, :-1], way[:, 1:]) & counts).any(axis=1)
        & finite
        & ~arm.any(axis=1)
    )
    return CastOutcome(
        np.where(finite, away, np.inf).reshape(shape),
        clear.reshape(shape),
        hit.reshape(shape),
    )


def midpoint_tip_path(tip: np.ndarray) -> np.ndarray:
    """The tip's way (C, T, 2) with a point between each two, by a cubic: (C, 2 T - 1,
    2). The pieces are then straight to 1 mm even at 1000 m/s^2.
    """
    padded = np.concatenate(
        [2 * tip[:, :1] - tip[:, 1:2], tip, 2 * tip[:, -1:] - tip[:, -2:-1]], axis=1
    )
    before, first, second, after = (
        padded[:, k : padded.shape[1] - 3 + k] for k in range(4)
    )
    way = np.empty((len(tip), 2 * tip.shape[1] - 1, 2))
    way[:, ::2], way[:, 1::2] = tip, (9 * (first + second) - before - after) / 16
    return way


def _contact_ticks(
    task: CastTask, angles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """At which ticks an obstacle is touched by the arm, and by the string or the tip's
    way from the tick before; each (C, T).
    """
    arm, string = np.zeros((2, *points.shape[:2]), dtype=bool)
    if not task.obstacles:
        return arm, string
    joints = task.model.arm.joint_positions(angles)
    for box in task.obstacles:
        arm |= box.is_crossed_by(joints[..., :-1, :], joints[..., 1:, :]).any(axis=2)
        # only strings beside it are looked at closely
        x, y = points[..., 0], points[..., 1]
        apart = (x.min(axis=2) > box.x + box.w / 2) | (
            x.max(axis=2) < box.x - box.w / 2
        )
        apart |= (y.min(axis=2) > box.y + box.h / 2) | (
            y.max(axis=2) < box.y - box.h / 2
        )
        near = points[~apart]
        string[~apart] |= box.is_crossed_by(near[:, :-1], near[:, 1:]).any(axis=1)
        string[:, 1:] |= box.is_crossed_by(points[:, :-1, -1], points[:, 1:, -1])
    return arm, string
