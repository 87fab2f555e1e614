"""Elastic bending moment, F_b of Table 1."""

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


class HingeSpring(StringEffect):
    """Moment proportional to curvature (Euler-Bernoulli). k_h, per mass point, is EI / (mu l^2)."""

    name = "hinge_spring"
    parameters = (
        Parameter("bending_stiffness", "N m/(rad kg)", "spring between segments", 8.0e-3, 4.0e2, 8.0e-3, "k_h", 2),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_b"
    symmetries = (
        odd("moment", "curvature"),
        nothing_at_zero("moment", "curvature"),
    )

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"the string bends with a stiffness of {values['bending_stiffness']:.3g} N m/(rad kg)"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the curvature."""
        curvature = np.linspace(-30.0, 30.0, 2)
        line(
            axes,
            curvature,
            cls.moment(curvature, values["bending_stiffness"]),
            "curvature / (1/m)",
            "moment / stiffness of a mass point",
        )

    @staticmethod
    def moment(curvature: Quantity, bending_stiffness: Quantity) -> Quantity:
        return bending_stiffness * curvature
