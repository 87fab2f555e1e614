"""Joints that move by a constant factor more or less than reported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import HandEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import follows, odd

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class JointGain(HandEffect):
    """Every joint turns 1 + gain times as far from its first angle as the arm reports."""

    name = "joint_gain"
    parameters = (Parameter("gain", "1", "what joints turn more than reported, as a share", -0.2, 0.2, 0.0),)
    reference = "Scale error of an encoder or a gear"
    symmetries = (odd("joints", "angles"), follows("joints", "angles"))

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        more = "more" if values["gain"] > 0 else "less"
        return f"the joints turn {100 * abs(values['gain']):.1f} % {more} than the arm reports"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """What the joint does over what is reported."""
        angle = np.linspace(0.0, 1.0, 2)
        real = cls.joints(angle, angle[None, :, None], values["gain"])[0, :, 0]
        line(axes, angle, real, "reported angle / rad", "angle / rad")

    @staticmethod
    def joints(t: np.ndarray, angles: np.ndarray, gain: Quantity) -> np.ndarray:
        """About the first angle."""
        return angles + gain * (angles - angles[:, :1])
