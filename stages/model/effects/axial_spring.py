"""Elastic force along the string, F_s of Table 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import nothing_at_zero, odd

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class AxialSpring(StringEffect):
    """Tension proportional to stretch (Hooke). k_s, per mass point, is EA / (mu l^2)."""

    name = "axial_spring"
    parameters = (
        Parameter("axial_stiffness", "N/(m kg)", "elastic force between mass points", 9.0e3, 9.0e5, 9.0e3, "k_s", 2),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_s"
    symmetries = (
        odd("tension", "stretch"),
        nothing_at_zero("tension", "stretch"),
    )

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"the string stretches with a stiffness of {values['axial_stiffness']:.3g} N/(m kg)"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the stretch."""
        stretch = np.linspace(-0.01, 0.01, 2)
        line(
            axes,
            stretch,
            cls.tension(stretch, values["axial_stiffness"]),
            "stretch",
            "tension / stiffness of a mass point",
        )

    @staticmethod
    def tension(stretch: Quantity, axial_stiffness: Quantity) -> Quantity:
        return axial_stiffness * stretch
