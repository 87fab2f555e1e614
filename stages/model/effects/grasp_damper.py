"""Damping moment between hand and string, F_phc of Table 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import nothing_at_zero, odd, resists

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class GraspDamper(StringEffect):
    """Moment proportional to the rate of the angle at the grasp. c_ph in the paper."""

    name = "grasp_damper"
    parameters = (
        Parameter("grasp_damping", "N m s/(rad kg)", "damper moment at the grasp", 1.1e-6, 0.37, 1.1e-6, "c_ph", 1),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_phc"
    symmetries = (
        odd("grasp_moment", "rate"),
        nothing_at_zero("grasp_moment", "rate"),
        resists("grasp_moment"),
    )

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"turning in the grasp is damped by {values['grasp_damping']:.3g} N m s/(rad kg)"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the rate."""
        rate = np.linspace(-10.0, 10.0, 2)
        line(
            axes,
            rate,
            cls.grasp_moment(rate, values["grasp_damping"]),
            "turning at the grasp / (rad/s)",
            "moment / damping of a mass point",
        )

    @staticmethod
    def grasp_moment(rate: Quantity, grasp_damping: Quantity) -> Quantity:
        return grasp_damping * rate
