"""Arm and camera clocks that run at different rates."""

import numpy as np

from stringcast.stages.model.effect import (
    ClockEffect,
    Parameter,
    Quantity,
    Values,
    is_odd,
)


class ClockDrift(ClockEffect):
    """A difference in rate between the arm's clock and the camera's.

    The clocks agree at t = 0, the start of the movement.
    """

    name = "clock_drift"
    parameters = (
        Parameter(
            "rate",
            "1",
            "relative gain of the arm's clock on the camera's",
            -0.05,
            0.05,
            0.0,
        ),
    )
    reference = "Change of the unit of time"
    invariants = (is_odd("times", "t"),)

    @staticmethod
    def describe(values: Values) -> str:
        faster = "faster" if values["rate"] > 0 else "slower"
        return (
            f"the arm's clock runs {1e3 * abs(values['rate']):.2f} ms per second "
            f"{faster} than the camera's"
        )

    @staticmethod
    def times(t: np.ndarray, rate: Quantity) -> np.ndarray:
        """Return times on the arm's clock."""
        return t * (1 + rate)
