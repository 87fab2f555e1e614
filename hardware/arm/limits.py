"""The whole movement is checked before anything moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm

ROUNDING_FACTOR = 1.001  # limits may be touched to rounding


@dataclass(frozen=True)
class Workspace:
    """The region in which joints and hand may be: a rectangle of the world, corners (x,
    y) [m].
    """

    low: tuple[float, float]
    high: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse a rectangle inside out."""
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError("each of workspace.low must be below its workspace.high")

    def is_left_by(self, points: np.ndarray) -> np.ndarray:
        """Whether any of the points lies outside. points: (..., P, 2) [m]. Returns
        (...).
        """
        return ~np.all((points >= self.low) & (points <= self.high), axis=(-2, -1))


def check_movement(arm: Arm, workspace: Workspace, angles: np.ndarray) -> None:
    """Refuse a movement that leaves a limit anywhere. angles: (K, J) on the tick [rad];
    raises HardwareError.
    """
    if not np.isfinite(angles).all():
        raise HardwareError(
            "arm: the movement holds angles that are no numbers; nothing was moved. Make it anew."
        )
    speeds = arm.commanded_velocities(angles)
    change = np.diff(speeds, axis=0, prepend=0.0) / arm.tick
    hand = np.linalg.norm(arm.grasp_velocity(angles, speeds)[:, :2], axis=1)
    checks = {
        "arm.lowest or arm.highest (range)": ~(
            (angles >= arm.lowest) & (angles <= arm.highest)
        ).all(axis=1),
        "arm.speed": ~(np.abs(speeds) <= ROUNDING_FACTOR * np.asarray(arm.speed)).all(
            axis=1
        ),
        "arm.hand_speed": ~(hand <= ROUNDING_FACTOR * arm.hand_speed),
        "arm.acceleration": ~(
            np.abs(change) <= ROUNDING_FACTOR * np.asarray(arm.acceleration)
        ).all(axis=1),
        "hardware.driving.workspace": workspace.is_left_by(arm.joint_positions(angles)),
    }  # each true where the limit is not known to hold: no comparison with NaN does
    for limit, bad in checks.items():
        if bad.any():
            at = float(np.argmax(bad)) * arm.tick
            raise HardwareError(
                f"arm: the movement leaves {limit} at {at:.3f} s; nothing was moved. Choose another motion."
            )
