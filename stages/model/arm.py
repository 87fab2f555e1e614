"""The planar arm: its geometry and the limits it must keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

PositiveFloat = Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class Arm:
    """A planar serial arm with revolute joints.

    links: link lengths [m], base first. base: where joint 1 sits [m]. lowest, highest:
    joint ranges [rad]. speed: joint speed limits [rad/s]. acceleration: joint
    acceleration limits [rad/s^2]. hand_speed: limit of the composite speed of the hand
    [m/s]. tick: period of the velocity commands [s].
    """

    links: tuple[PositiveFloat, ...]
    base: tuple[float, float]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    speed: tuple[PositiveFloat, ...]
    acceleration: tuple[PositiveFloat, ...]
    hand_speed: PositiveFloat
    tick: PositiveFloat

    def __post_init__(self) -> None:
        """Refuse limits that do not belong to the links."""
        for name in ("lowest", "highest", "speed", "acceleration"):
            if len(getattr(self, name)) != len(self.links):
                raise ValueError(
                    f"{name} has {len(getattr(self, name))} values, links has {len(self.links)}"
                )
        if any(
            low >= high for low, high in zip(self.lowest, self.highest, strict=True)
        ):
            raise ValueError("each of lowest must be below its highest")

    @property
    def reach(self) -> float:
        """Distance from the base to the outstretched hand [m]."""
        return float(sum(self.links))

    def commanded_velocities(self, angles: np.ndarray) -> np.ndarray:
        """Commanded joint velocities (..., K, J) [rad/s]: each the mean over its tick,
        zero at the end. angles: (..., K, J) [rad].
        """
        return np.concatenate(
            [np.diff(angles, axis=-2) / self.tick, np.zeros_like(angles[..., :1, :])],
            axis=-2,
        )

    def joint_positions(self, angles: np.ndarray) -> np.ndarray:
        """Positions of base, joints and hand [m].

        angles: (..., J) joint angles [rad]. Returns (..., J + 1, 2).
        """
        places = np.empty((*angles.shape[:-1], len(self.links) + 1, 2))
        places[..., 0, :] = self.base
        direction = np.zeros(angles.shape[:-1])
        # Joint by joint: NumPy is slow along axes as short as these.
        for joint, link in enumerate(self.links):
            direction += angles[..., joint]
            places[..., joint + 1, 0] = places[..., joint, 0] + link * np.cos(direction)
            places[..., joint + 1, 1] = places[..., joint, 1] + link * np.sin(direction)
        return places

    def grasp_pose(self, angles: np.ndarray) -> np.ndarray:
        """Pose of the grasp: (..., 3) of x [m], y [m], theta [rad], theta unwrapped
        along the last link.

        angles: (..., J) joint angles [rad].
        """
        hand = self.joint_positions(angles)[..., -1, :]
        return np.concatenate([hand, np.sum(angles, axis=-1, keepdims=True)], axis=-1)

    def grasp_velocity(self, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Rate of `grasp`: (..., 3) of m/s, m/s, rad/s.

        angles, speeds: (..., J) [rad], [rad/s].
        """
        rate = np.zeros((*angles.shape[:-1], 3))
        direction = np.zeros(angles.shape[:-1])
        for joint, link in enumerate(self.links):
            direction += angles[..., joint]
            rate[..., 2] += speeds[..., joint]
            rate[..., 0] -= link * rate[..., 2] * np.sin(direction)
            rate[..., 1] += link * rate[..., 2] * np.cos(direction)
        return rate
