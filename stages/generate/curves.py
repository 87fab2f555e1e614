"""Joint-velocity curves: degree-5 Bezier curves over control points V_0..V_5 (III)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import comb

from stringcast.data.artifacts import JOINTS, Motion
from stringcast.stages.model.arm import Arm

# degree of the Bezier curves of joint speeds (Eq. 2): six control points each
INTERVALS = 5
ROUNDING = 1e-9  # rounding error of a share of the duration


@dataclass(frozen=True)
class Curves:
    """A batch of motions.

    Parameters
    ----------
    start : (B, J) initial joint angles [rad]
    duration : (B,) durations T, whole ticks [s]
    control : (B, J, 6) control points V_0..V_5 of joint speed [rad/s]
    """

    start: np.ndarray
    duration: np.ndarray
    control: np.ndarray

    def sample(self, tick: float, until: float) -> tuple[np.ndarray, np.ndarray]:
        """Sample angles [rad] and velocities [rad/s] at ticks, (B, K, J) each.

        Ticks run from 0 to `until` [s]; the arm rests after T.
        """
        times = np.arange(round(until / tick) + 1) * tick
        share = times / self.duration[:, None]  # of T, (B, K)
        u = np.clip(share, 0, 1)[:, :, None]

        weights = _bernstein(u, INTERVALS)
        speed = np.einsum("bkn,bjn->bkj", weights, self.control)
        is_moving = share <= 1 + ROUNDING  # the tick at T still moves
        speed = speed * is_moving[..., None]

        # its integral has one degree more; its control points are cumulative sums
        sums = np.cumsum(self.control, axis=-1)
        sums = np.pad(sums, ((0, 0), (0, 0), (1, 0)))
        weights = _bernstein(u, INTERVALS + 1)
        turn = np.einsum("bkn,bjn->bkj", weights, sums / (INTERVALS + 1))
        angles = self.start[:, None] + turn * self.duration[:, None, None]
        return angles, speed

    def select(self, chosen: np.ndarray | slice) -> Curves:
        """Select motions by their numbers."""
        return Curves(self.start[chosen], self.duration[chosen], self.control[chosen])


def curves_from_motion(motion: Motion) -> Curves:
    """Restore the curves of an earlier motion."""
    control = motion.control_points.pivot(
        index="joint", columns="index", values="velocity"
    ).to_numpy()
    start = motion.commands[list(JOINTS)].iloc[:1].to_numpy()
    return Curves(start, np.array([motion.duration]), control[None])


def join_curves(parts: Sequence[Curves]) -> Curves:
    """Join several batches of motions."""
    return Curves(
        np.concatenate([part.start for part in parts]),
        np.concatenate([part.duration for part in parts]),
        np.concatenate([part.control for part in parts]),
    )


def first_curves(
    arm: Arm,
    rng: np.random.Generator,
    count: int,
    durations: tuple[float, float],
    alpha: float,
) -> Curves:
    """Draw random poses and curves.

    durations: range of T [s]. alpha: limit of the accelerations alpha_n [rad/s^2].
    """
    joints = len(arm.links)
    start = rng.uniform(arm.lowest, arm.highest, (count, joints))
    duration = whole_ticks(rng.uniform(*durations, count), arm.tick)
    acceleration = rng.uniform(-alpha, alpha, (count, joints, INTERVALS - 1))
    return Curves(start, duration, control_points(acceleration, duration))


def control_points(acceleration: np.ndarray, duration: np.ndarray) -> np.ndarray:
    """Compute V_n = alpha_n T / 5 with V_0 = V_5 = 0 (Eq. 2), (B, J, 6) [rad/s].

    acceleration: alpha_n, (B, J, 4) [rad/s^2]. duration: T, (B,) [s].
    """
    inner = acceleration * duration[:, None, None] / INTERVALS
    return np.pad(inner, ((0, 0), (0, 0), (1, 1)))


def next_curves(
    arm: Arm,
    rng: np.random.Generator,
    count: int,
    durations: tuple[float, float],
    alpha: float,
    last: Curves,
    fraction: float,
) -> Curves:
    """Draw slight changes of the last motion, from the same start.

    T differs by up to a quarter of the range of durations, V_1..V_4 by up to `fraction`
    of their range.
    """
    change = (durations[1] - durations[0]) / 4
    duration = last.duration[0] + rng.uniform(-change, change, count)
    duration = whole_ticks(np.clip(duration, *durations), arm.tick)
    fastest = alpha * duration[:, None] / INTERVALS
    limit = np.minimum(fastest, np.asarray(arm.speed))
    shares = rng.uniform(-1, 1, (count, len(arm.links), INTERVALS - 1))
    control = np.repeat(last.control, count, axis=0)
    control[..., 1:-1] += shares * fraction * limit[..., None]
    return Curves(np.repeat(last.start, count, axis=0), duration, control)


def plain_cast(arm: Arm, duration: float) -> Curves:
    """Build a swing of all joints through the middle third of their ranges.

    duration: duration of the swing [s].
    """
    lowest, highest = np.asarray(arm.lowest), np.asarray(arm.highest)
    sweep = (highest - lowest) / 3
    start = (lowest + highest - sweep) / 2
    durations = whole_ticks(np.array([duration]), arm.tick)
    # the mean speed is the mean control point, of which the outer two are zero
    speed = sweep / durations * (INTERVALS + 1) / (INTERVALS - 1)
    control = np.zeros((1, len(sweep), INTERVALS + 1))
    control[0, :, 1:-1] = speed[:, None]
    return Curves(start[None], durations, control)


def whole_ticks(duration: np.ndarray, tick: float) -> np.ndarray:
    """Round durations [s] to whole ticks [s], at least one for each interval."""
    return np.maximum(np.round(duration / tick), INTERVALS) * tick


def _bernstein(u: np.ndarray, degree: int) -> np.ndarray:
    """Bernstein polynomials at u (..., 1), (..., degree + 1)."""
    u_powers, rest_powers = np.ones((2, *u.shape[:-1], degree + 1))
    # repeated products are several times faster than powers
    for n in range(degree):
        u_powers[..., n + 1] = u_powers[..., n] * u[..., 0]
        rest_powers[..., n + 1] = rest_powers[..., n] * (1 - u[..., 0])
    choices = comb(degree, np.arange(degree + 1))
    return choices * u_powers * rest_powers[..., ::-1]
