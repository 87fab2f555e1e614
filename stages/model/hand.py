"""The hand's motion: the pose of the grasp in time, as the string engine consumes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from stages.model.arm import Arm

HAND_TICK = 0.005


@dataclass(frozen=True)
class HandMotion:
    """Poses of the grasp on a uniform tick, cubic Hermite between.

    start: time of the first pose [s]. tick: period [s]. pose: (B, K, 3) x [m], y [m],
    theta [rad], theta continuous. rate: (B, K, 3) its time derivative. B is the number of
    motions: 1 (shared by all candidates) or one for each candidate.
    """

    start: float
    tick: float
    pose: np.ndarray
    rate: np.ndarray

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return self.start + (self.pose.shape[1] - 1) * self.tick


def hand_motion(arm: Arm, t: np.ndarray, angles: np.ndarray, tick: float = HAND_TICK) -> HandMotion:
    """The hand's motion from joint angles.

    t: (K,) increasing times [s]. angles: (K, J) or (B, K, J) joint angles [rad]. The joints
    are taken as natural cubic splines between samples; tick: period of the result [s].
    """
    grid = _grid(t, tick)
    batch = angles if angles.ndim == 3 else angles[None]
    spline = CubicSpline(t, batch, axis=1, bc_type="natural")
    q, w = spline(grid), spline(grid, 1)
    return HandMotion(float(grid[0]), tick, arm.grasp(q), arm.grasp_velocity(q, w))


def hand_motion_from_grasp(t: np.ndarray, pose: np.ndarray, tick: float = HAND_TICK) -> HandMotion:
    """The hand's motion from grasp poses. t: (K,) increasing [s]; pose: (K, 3) or (B, K, 3), theta unwrapped here."""
    batch = np.array(pose if pose.ndim == 3 else pose[None], dtype=float)
    batch[..., 2] = np.unwrap(batch[..., 2], axis=1)
    grid = _grid(t, tick)
    spline = CubicSpline(t, batch, axis=1, bc_type="natural")
    return HandMotion(float(grid[0]), tick, spline(grid), spline(grid, 1))


def _grid(t: np.ndarray, tick: float) -> np.ndarray:
    """Ticks from the first sample to the last that fits, at least two."""
    count = max(int(np.floor((t[-1] - t[0]) / tick + 1e-9)) + 1, 2)
    return t[0] + tick * np.arange(count)
