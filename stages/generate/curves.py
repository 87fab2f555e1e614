"""Joint-velocity curves: degree-5 Bezier curves over control points V_0..V_5 (III)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import comb

from stringcast.stages.model.arm import Arm

# degree of the Bezier curves of joint speeds (Eq. 2): six control points each
INTERVALS = 5


@dataclass(frozen=True)
class Curves:
    """A batch of movements. start: (B, J) initial angles [rad]. duration: (B,) T [s],
    whole ticks. control: (B, J, 6) V_0..V_5 [rad/s].
    """

    start: np.ndarray
    duration: np.ndarray
    control: np.ndarray

    def sample(self, tick: float, until: float) -> tuple[np.ndarray, np.ndarray]:
        """Angles and velocities (B, K, J) on the tick from 0 to `until` [s]; at rest
        after T.
        """
        u = np.arange(round(until / tick) + 1) * tick / self.duration[:, None]
        inside = np.clip(u, 0, 1)[:, :, None]
        # the tick at T still moves, whatever the rounding
        speed = (
            np.einsum("bkn,bjn->bkj", _bernstein(inside), self.control)
            * (u <= 1 + 1e-9)[..., None]
        )
        # The integral of a Bezier curve is one of a degree more over the sums of its
        # points.
        sums = np.concatenate(
            [np.zeros((*self.control.shape[:2], 1)), np.cumsum(self.control, axis=-1)],
            axis=-1,
        )
        turned = np.einsum(
            "bkn,bjn->bkj", _bernstein(inside, INTERVALS + 1), sums / (INTERVALS + 1)
        )
        return self.start[:, None] + turned * self.duration[:, None, None], speed

    def select(self, chosen: np.ndarray | slice) -> Curves:
        """Some of the movements, by their numbers."""
        return Curves(self.start[chosen], self.duration[chosen], self.control[chosen])


def join_curves(parts: Sequence[Curves]) -> Curves:
    """Several batches of movements as one."""
    return Curves(
        *(
            np.concatenate([getattr(p, name) for p in parts])
            for name in ("start", "duration", "control")
        )
    )


def first_curves(
    arm: Arm,
    rng: np.random.Generator,
    count: int,
    durations: tuple[float, float],
    alpha: float,
) -> Curves:
    """Random poses and curves: V_n = alpha_n (t_n - t_{n-1}), V_0 = V_5 = 0 (Eq. 2)."""
    start = rng.uniform(arm.lowest, arm.highest, (count, len(arm.links)))
    duration = whole_ticks(rng.uniform(*durations, count), arm.tick)
    control = np.zeros((count, len(arm.links), INTERVALS + 1))
    acceleration = rng.uniform(-alpha, alpha, (count, len(arm.links), INTERVALS - 1))
    control[..., 1:-1] = acceleration * duration[:, None, None] / INTERVALS
    return Curves(start, duration, control)


def next_curves(
    arm: Arm,
    rng: np.random.Generator,
    count: int,
    durations: tuple[float, float],
    alpha: float,
    last: Curves,
    fraction: float,
) -> Curves:
    """Slight changes of the last movement: same start, T within half its first range
    around the last, V_1..V_4 within `fraction` of their range.
    """
    half = (durations[1] - durations[0]) / 4
    duration = whole_ticks(
        np.clip(last.duration[0] + rng.uniform(-half, half, count), *durations),
        arm.tick,
    )
    reach = np.minimum(alpha * duration[:, None] / INTERVALS, np.asarray(arm.speed))
    change = (
        rng.uniform(-1, 1, (count, len(arm.links), INTERVALS - 1))
        * fraction
        * reach[..., None]
    )
    control = np.repeat(last.control, count, axis=0)
    control[..., 1:-1] += change
    return Curves(np.repeat(last.start, count, axis=0), duration, control)


def plain_cast(arm: Arm, duration: float) -> Curves:
    """One swing of all joints together, through the middle third of their ranges in
    `duration` [s].
    """
    lowest, highest = np.asarray(arm.lowest), np.asarray(arm.highest)
    sweep = (highest - lowest) / 3
    whole = whole_ticks(np.array([duration]), arm.tick)
    control = np.zeros((1, len(sweep), INTERVALS + 1))
    control[0, :, 1:-1] = (sweep / whole * (INTERVALS + 1) / (INTERVALS - 1))[:, None]
    return Curves(((lowest + highest - sweep) / 2)[None], whole, control)


def whole_ticks(duration: np.ndarray, tick: float) -> np.ndarray:
    """Durations of any shape [s] rounded to ticks, at least as many as there are
    intervals. tick: [s].
    """
    return np.maximum(np.round(duration / tick), INTERVALS) * tick


def _bernstein(u: np.ndarray, degree: int = INTERVALS) -> np.ndarray:
    """Bernstein's polynomials at u (..., 1), (..., degree + 1)."""
    n = np.arange(degree + 1)
    return comb(degree, n) * u**n * (1 - u) ** (degree - n)
