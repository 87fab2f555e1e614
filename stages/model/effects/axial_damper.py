"""Damping along the string, F_d of Table 1."""

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


class AxialDamper(StringEffect):
    """Tension proportional to the rate of stretch (Kelvin-Voigt). c_s in the paper."""

    name = "axial_damper"
    parameters = (
        Parameter("axial_damping", "N s/(m kg)", "damping force between mass points", 0.13, 1.3e3, 0.13, "c_s", 2),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_d"
    symmetries = (
        odd("tension", "rate"),
        nothing_at_zero("tension", "rate"),
        resists("tension"),
    )

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"stretching is damped by {values['axial_damping']:.3g} N s/(m kg)"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the rate."""
        rate = np.linspace(-10.0, 10.0, 2)
        line(
            axes,
            rate,
            cls.tension(rate, values["axial_damping"]),
            "rate of stretch / (1/s)",
            "tension / damping of a mass point",
        )

    @staticmethod
    def tension(rate: Quantity, axial_damping: Quantity) -> Quantity:
        return axial_damping * rate
