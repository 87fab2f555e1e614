"""A string that leaves the gripper at an angle."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    HandEffect,
    Parameter,
    Quantity,
    Values,
    draw_line,
    moves_with_pose,
)


class GraspAngle(HandEffect):
    """A counter-clockwise turn of the grasp's direction from the last link's."""

    name = "grasp_angle"
    parameters = (
        Parameter(
            "angle",
            "rad",
            "angle from the last link to the string",
            -0.8,
            0.8,
            0.0,
        ),
    )
    varies_between_trials = True
    reference = "Rotation of the grasp"
    invariants = (moves_with_pose("grasp", "pose"),)

    @staticmethod
    def describe(values: Values) -> str:
        side = "left" if values["angle"] > 0 else "right"
        return (
            f"the string leaves the gripper {np.degrees(abs(values['angle'])):.1f} "
            f"degrees to the {side}"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the last link and the beginning of the string."""
        axes.plot([-1.0, 0.0], [0.0, 0.0], linestyle="--")
        distance = np.linspace(0.0, 1.0, 2)
        draw_line(
            axes,
            distance * np.cos(values["angle"]),
            distance * np.sin(values["angle"]),
            "along the last link",
            "across",
        )

    @staticmethod
    def grasp(t: np.ndarray, pose: np.ndarray, angle: Quantity) -> np.ndarray:
        """Return the poses with the direction turned."""
        return pose + angle * np.array([0.0, 0.0, 1.0])
