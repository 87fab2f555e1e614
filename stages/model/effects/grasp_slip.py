"""A string that slides through the gripper during the motion."""

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


class GraspSlip(HandEffect):
    """A slide of the string out of the gripper at a constant speed, for some time.

    It slides along the grasp's direction. The part that has come out is assumed
    straight, and the free string keeps its length. This holds for a slip much shorter
    than the string. Onset and end are smooth over some 20 ms.
    """

    name = "grasp_slip"
    parameters = (
        Parameter(
            "speed", "m/s", "speed at which the string slides out", -0.3, 0.3, 0.0
        ),
        Parameter("onset", "s", "beginning of the slide", 0.0, 2.0, 0.2),
        Parameter("duration", "s", "duration of the slide", 0.0, 4.0, 1.0, root=2),
    )
    reference = "Kinematics of a string that is paid out"
    invariants = (moves_with_pose("grasp", "pose"),)

    @staticmethod
    def describe(values: Values) -> str:
        direction = "out of" if values["speed"] > 0 else "into"
        speed, until = 1e3 * abs(values["speed"]), values["onset"] + values["duration"]
        return (
            f"the string slides {direction} the gripper at {speed:.1f} mm/s from "
            f"{values['onset']:.2f} to {until:.2f} s"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the distance slid over time."""
        t = np.linspace(0.0, 2.0, 201)
        still = np.zeros((1, len(t), 3))
        draw_line(
            axes, t, cls.grasp(t, still, **values)[0, :, 0], "time [s]", "slid out [m]"
        )

    @staticmethod
    def grasp(
        t: np.ndarray,
        pose: np.ndarray,
        speed: Quantity,
        onset: Quantity,
        duration: Quantity,
    ) -> np.ndarray:
        """Return the poses moved by the distance slid.

        The speed rises and falls as a logistic function; the distance is its integral.
        """
        rise, since_onset = 0.005, t[:, None] - onset  # [s]
        rising, falling = (
            np.logaddexp(0.0, elapsed / rise)
            for elapsed in (since_onset, since_onset - duration)
        )
        distance = speed * rise * (rising - falling)
        theta = pose[..., 2:]
        return pose + distance * np.concatenate(
            [np.cos(theta), np.sin(theta), 0 * theta], axis=-1
        )
