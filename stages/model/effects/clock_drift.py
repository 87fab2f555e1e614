"""Arm and camera clocks that run at different rates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import ClockEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import odd

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class ClockDrift(ClockEffect):
    """The arm's clock gains on the camera's from t = 0, the start of the movement, where both agree."""

    name = "clock_drift"
    parameters = (Parameter("rate", "1", "what the arm's clock gains on the camera's, as a share", -0.05, 0.05, 0.0),)
    reference = "Change of the unit of time"
    symmetries = (odd("times", "t"),)

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        faster = "faster" if values["rate"] > 0 else "slower"
        return f"the arm's clock runs {1e3 * abs(values['rate']):.2f} ms a second {faster} than the camera's"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """The difference over time."""
        t = np.linspace(0.0, 1.0, 2)
        line(axes, t, cls.times(t, values["rate"]) - t, "camera's clock / s", "arm's clock less that / s")

    @staticmethod
    def times(t: np.ndarray, rate: Quantity) -> np.ndarray:
        """The same moments on the arm's clock."""
        return t * (1 + rate)
