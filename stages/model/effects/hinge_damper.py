"""Damping in bending, F_h of Table 1."""

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


class HingeDamper(StringEffect):
    """Moment proportional to the rate of curvature. c_h in the paper."""

    name = "hinge_damper"
    parameters = (
        Parameter("bending_damping", "N m s/(rad kg)", "damper between segments", 3.0e-7, 0.67, 3.0e-7, "c_h", 2),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_h"
    symmetries = (
        odd("moment", "rate"),
        nothing_at_zero("moment", "rate"),
        resists("moment"),
    )

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"bending is damped by {values['bending_damping']:.3g} N m s/(rad kg)"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the rate."""
        rate = np.linspace(-300.0, 300.0, 2)
        line(
            axes,
            rate,
            cls.moment(rate, values["bending_damping"]),
            "rate of curvature / (1/(m s))",
            "moment / damping of a mass point",
        )

    @staticmethod
    def moment(rate: Quantity, bending_damping: Quantity) -> Quantity:
        return bending_damping * rate
