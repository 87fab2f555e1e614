"""Arm and camera clocks that differ by a constant."""

import numpy as np

from stringcast.stages.model.effect import (
    ClockEffect,
    Parameter,
    Quantity,
    Values,
    shifts_with,
)


class TimeOffset(ClockEffect):
    """A constant advance of the arm's clock over the camera's.

    A delay of the frames' time stamps looks the same.
    """

    name = "time_offset"
    parameters = (
        Parameter("offset", "s", "arm's clock minus the camera's", -0.05, 0.05, 0.0),
    )
    reference = "Change of the origin of time"
    invariants = (shifts_with("times", "t"),)

    @staticmethod
    def describe(values: Values) -> str:
        order = "ahead of" if values["offset"] > 0 else "behind"
        return (
            f"the arm's clock is {1e3 * abs(values['offset']):.1f} ms {order} the "
            f"camera's"
        )

    @staticmethod
    def times(t: np.ndarray, offset: Quantity) -> np.ndarray:
        """Return times on the arm's clock."""
        return t + offset
