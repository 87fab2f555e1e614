"""Checks of a whole movement before anything moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm

ROUNDING_FACTOR = 1.001  # tolerance for rounding at a limit


@dataclass(frozen=True)
class Workspace:
    """The rectangle allowed for joints and hand, by two corners (x, y) [m]."""

    low: tuple[float, float]
    high: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse a rectangle with exchanged corners."""
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError("each of workspace.low must be below its workspace.high")

    def is_left_by(self, points: np.ndarray) -> np.ndarray:
        """Return whether any of the points (..., P, 2) [m] is outside, (...)."""
        is_inside = (points >= self.low) & (points <= self.high)
        return np.asarray(~is_inside.all(axis=(-2, -1)))


def check_movement(arm: Arm, workspace: Workspace, angles: np.ndarray) -> None:
    """Refuse a movement that leaves a limit at any tick.

    Parameters
    ----------
    arm
        The arm with its limits.
    workspace
        The region for joints and hand.
    angles : (K, J)
        Joint angles at each tick [rad].

    Raises
    ------
    HardwareError
        If a limit is left; it names the limit and the time.
    """
    if not np.isfinite(angles).all():
        raise HardwareError(
            "arm",
            "the movement holds angles that are no numbers; nothing was moved",
            "Generate it again.",
        )
    speeds = arm.commanded_velocities(angles)
    accelerations = np.diff(speeds, axis=0, prepend=0.0) / arm.tick
    hand = np.linalg.norm(arm.grasp_velocity(angles, speeds)[:, :2], axis=1)
    most_speed = ROUNDING_FACTOR * np.asarray(arm.speed)
    most_acceleration = ROUNDING_FACTOR * np.asarray(arm.acceleration)
    in_range = (angles >= arm.lowest) & (angles <= arm.highest)
    # negated comparisons, so that NaN violates the limit
    violations = {
        "arm.lowest or arm.highest (range)": ~in_range.all(axis=1),
        "arm.speed": ~(np.abs(speeds) <= most_speed).all(axis=1),
        "arm.hand_speed": ~(hand <= ROUNDING_FACTOR * arm.hand_speed),
        "arm.acceleration": ~(np.abs(accelerations) <= most_acceleration).all(axis=1),
        "hardware.driving.workspace": workspace.is_left_by(arm.joint_positions(angles)),
    }
    for limit, is_violated in violations.items():
        if is_violated.any():
            time = float(np.argmax(is_violated)) * arm.tick
            raise HardwareError(
                "arm",
                f"the movement leaves {limit} at {time:.3f} s; nothing was moved",
                "Choose another motion.",
            )
