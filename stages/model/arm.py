"""The planar arm: its geometry and the limits it must keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class Arm:
    """A planar serial arm with revolute joints.

    links: link lengths [m], base first. base: where joint 1 sits [m].
    lowest, highest: joint ranges [rad]. speed: joint speed limits [rad/s].
    acceleration: joint acceleration limits [rad/s^2]. hand_speed: limit of the composite
    speed of the hand [m/s]. tick: period of the velocity commands [s].
    """

    links: tuple[Positive, ...]
    base: tuple[float, float]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    speed: tuple[Positive, ...]
    acceleration: tuple[Positive, ...]
    hand_speed: Positive
    tick: Positive

    def __post_init__(self) -> None:
        """Refuse limits that do not belong to the links."""
        for name in ("lowest", "highest", "speed", "acceleration"):
            if len(getattr(self, name)) != len(self.links):
                raise ValueError(f"{name} has {len(getattr(self, name))} values, links has {len(self.links)}")
        if any(low >= high for low, high in zip(self.lowest, self.highest, strict=True)):
            raise ValueError("each of lowest must be below its highest")

    @property
    def reach(self) -> float:
        """Distance from the base to the outstretched hand [m]."""
        return float(sum(self.links))

    def commanded(self, angles: np.ndarray) -> np.ndarray:
        """What the arm is told, (..., K, J) [rad/s]: a tick's mean, zero at the end. angles: likewise [rad]."""
        return np.concatenate([np.diff(angles, axis=-2) / self.tick, np.zeros_like(angles[..., :1, :])], axis=-2)

    def joints(self, angles: np.ndarray) -> np.ndarray:
        """Positions of base, joints and hand [m].

        angles: (..., J) joint angles [rad]. Returns (..., J + 1, 2).
        """
        absolute = np.cumsum(angles, axis=-1)
        steps = np.stack([np.cos(absolute), np.sin(absolute)], axis=-1) * np.asarray(self.links)[:, None]
        base = np.broadcast_to(np.asarray(self.base), (*steps.shape[:-2], 1, 2))
        return np.concatenate([base, base + np.cumsum(steps, axis=-2)], axis=-2)

    def grasp(self, angles: np.ndarray) -> np.ndarray:
        """Pose of the grasp: (..., 3) of x [m], y [m], theta [rad], theta unwrapped along the last link.

        angles: (..., J) joint angles [rad].
        """
        hand = self.joints(angles)[..., -1, :]
        return np.concatenate([hand, np.sum(angles, axis=-1, keepdims=True)], axis=-1)

    def grasp_velocity(self, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Rate of `grasp`: (..., 3) of m/s, m/s, rad/s.

        angles, speeds: (..., J) [rad], [rad/s].
        """
        points = self.joints(angles)
        lever = points[..., -1:, :] - points[..., :-1, :]
        across = np.stack([-lever[..., 1], lever[..., 0]], axis=-1)
        hand = np.sum(across * speeds[..., None], axis=-2)
        return np.concatenate([hand, np.sum(speeds, axis=-1, keepdims=True)], axis=-1)
