"""The planar arm: its geometry and limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveFloat


@dataclass(frozen=True)
class Arm:
    """A planar serial arm with revolute joints.

    Parameters
    ----------
    links : tuple of float
        Link lengths [m], base first.
    base : (float, float)
        Position of joint 1 [m].
    lowest, highest : tuple of float
        Joint ranges [rad].
    speed : tuple of float
        Joint speed limits [rad/s].
    acceleration : tuple of float
        Joint acceleration limits [rad/s^2].
    hand_speed : float
        Limit of the composite speed of the hand [m/s].
    tick : float
        Period of the velocity commands [s].

    Raises
    ------
    ValueError
        If the number of limits is not that of the links, or a range is empty.
    """

    links: tuple[PositiveFloat, ...]
    base: tuple[float, float]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    speed: tuple[PositiveFloat, ...]
    acceleration: tuple[PositiveFloat, ...]
    hand_speed: PositiveFloat
    tick: Annotated[float, Field(ge=1e-4, le=1.0)]

    def __post_init__(self) -> None:
        """Refuse limits that do not fit the links."""
        joints = len(self.links)
        for name in ("lowest", "highest", "speed", "acceleration"):
            count = len(getattr(self, name))
            if count != joints:
                raise ValueError(f"{name} has {count} values, links has {joints}")
        for low, high in zip(self.lowest, self.highest, strict=True):
            if low >= high:
                raise ValueError("each of lowest must be below its highest")

    @property
    def reach(self) -> float:
        """Distance from the base to the outstretched hand [m]."""
        return float(sum(self.links))

    def commanded_velocities(self, angles: np.ndarray) -> np.ndarray:
        """Return the velocity commands of a motion, (..., K, J) [rad/s].

        Each command is the mean over its tick; the last is zero.

        angles: (..., K, J) [rad].
        """
        velocities = np.diff(angles, axis=-2) / self.tick
        last = np.zeros_like(angles[..., :1, :])
        return np.concatenate([velocities, last], axis=-2)

    def joint_positions(self, angles: np.ndarray) -> np.ndarray:
        """Return the positions of base, joints and hand.

        Parameters
        ----------
        angles : ndarray of shape (..., J)
            Joint angles [rad].

        Returns
        -------
        ndarray of shape (..., J + 1, 2)
            Positions [m].
        """
        positions = np.empty((*angles.shape[:-1], len(self.links) + 1, 2))
        positions[..., 0, :] = self.base
        direction = np.zeros(angles.shape[:-1])
        # A loop over joints, because NumPy is slow along short axes.
        for joint, link in enumerate(self.links):
            direction += angles[..., joint]
            x, y = positions[..., joint, 0], positions[..., joint, 1]
            positions[..., joint + 1, 0] = x + link * np.cos(direction)
            positions[..., joint + 1, 1] = y + link * np.sin(direction)
        return positions

    def grasp_pose(self, angles: np.ndarray) -> np.ndarray:
        """Return the pose of the grasp.

        Parameters
        ----------
        angles : ndarray of shape (..., J)
            Joint angles [rad].

        Returns
        -------
        ndarray of shape (..., 3)
            x [m], y [m] and unwrapped direction theta of the last link [rad].
        """
        hand = self.joint_positions(angles)[..., -1, :]
        theta = np.sum(angles, axis=-1, keepdims=True)
        return np.concatenate([hand, theta], axis=-1)

    def grasp_velocity(self, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Return the rate of `grasp_pose`, (..., 3) [m/s], [m/s], [rad/s].

        Parameters
        ----------
        angles, speeds : ndarray of shape (..., J)
            Joint angles [rad] and speeds [rad/s].
        """
        _, rate = self.grasp_pose_and_velocity(angles, speeds)
        return rate

    def grasp_pose_and_velocity(
        self, angles: np.ndarray, speeds: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return `grasp_pose` and its rate `grasp_velocity`, (..., 3) each.

        Parameters
        ----------
        angles, speeds : ndarray of shape (..., J)
            Joint angles [rad] and speeds [rad/s].
        """
        shape = angles.shape[:-1]
        direction, turn_rate, velocity_x, velocity_y = np.zeros((4, *shape))
        x, y = np.full(shape, self.base[0]), np.full(shape, self.base[1])
        for joint, link in enumerate(self.links):
            direction += angles[..., joint]
            turn_rate += speeds[..., joint]
            sine, cosine = np.sin(direction), np.cos(direction)
            x += link * cosine
            y += link * sine
            link_speed = link * turn_rate
            velocity_x -= link_speed * sine
            velocity_y += link_speed * cosine
        pose = np.stack([x, y, direction], axis=-1)
        rate = np.stack([velocity_x, velocity_y, turn_rate], axis=-1)
        return pose, rate
