"""Arm and camera clocks that differ by a constant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import ClockEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import follows

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class TimeOffset(ClockEffect):
    """The arm's clock shows `offset` more than the camera's; a delay of the pictures' stamps looks the same."""

    name = "time_offset"
    parameters = (Parameter("offset", "s", "arm's clock less the camera's", -0.05, 0.05, 0.0),)
    reference = "Change of the origin of time"
    symmetries = (follows("times", "t"),)

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        order = "ahead of" if values["offset"] > 0 else "behind"
        return f"the arm's clock is {1e3 * abs(values['offset']):.1f} ms {order} the camera's"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """The difference over time."""
        t = np.linspace(0.0, 1.0, 2)
        line(axes, t, cls.times(t, values["offset"]) - t, "camera's clock / s", "arm's clock less that / s")

    @staticmethod
    def times(t: np.ndarray, offset: Quantity) -> np.ndarray:
        """The same moments on the arm's clock."""
        return t + offset
