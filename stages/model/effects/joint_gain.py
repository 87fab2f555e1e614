"""Joints that turn by a constant factor more or less than reported."""

import numpy as np

from stringcast.stages.model.effect import (
    HandEffect,
    Parameter,
    Quantity,
    Values,
    is_odd,
    shifts_with,
)


class JointGain(HandEffect):
    """A gain of every joint: it turns 1 + gain times as far as the arm reports.

    Turns count from the first angle.
    """

    name = "joint_gain"
    parameters = (
        Parameter(
            "gain",
            "1",
            "relative excess of actual over reported turns",
            -0.2,
            0.2,
            0.0,
        ),
    )
    reference = "Scale error of an encoder or a gear"
    invariants = (is_odd("joints", "angles"), shifts_with("joints", "angles"))

    @staticmethod
    def describe(values: Values) -> str:
        more = "more" if values["gain"] > 0 else "less"
        return f"the joints turn {100 * abs(values['gain']):.1f} % {more} than reported"

    @staticmethod
    def joints(t: np.ndarray, angles: np.ndarray, gain: Quantity) -> np.ndarray:
        """Return the angles, with changes since the first scaled by 1 + gain."""
        return angles + gain * (angles - angles[:, :1])
