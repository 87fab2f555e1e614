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
    """A gain of the arm's clock on the camera's.

    It counts from t = 0, the start of the movement, where both agree.
    """

    name = "clock_drift"
    parameters = (
        Parameter(
            "rate",
            "1",
            "what the arm's clock gains on the camera's, as a share",
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
            f"the arm's clock runs {1e3 * abs(values['rate']):.2f} ms a second "
            f"{faster} than the camera's"
        )

    @staticmethod
    def times(t: np.ndarray, rate: Quantity) -> np.ndarray:
        """Return times on the arm's clock."""
        drifted: np.ndarray = t * (1 + rate)
        return drifted
