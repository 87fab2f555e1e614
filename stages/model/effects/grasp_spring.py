"""Elastic moment between hand and string, F_ph of Table 1."""

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


class GraspSpring(StringEffect):
    """Moment proportional to the angle between the grasp's direction and the string. k_ph in the paper."""

    name = "grasp_spring"
    parameters = (
        Parameter("grasp_stiffness", "N m/(rad kg)", "spring moment at the grasp", 1.0e-3, 5.0, 1.0e-3, "k_ph", 1),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_ph"
    symmetries = (
        odd("grasp_moment", "angle"),
        nothing_at_zero("grasp_moment", "angle"),
    )

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"the grasp holds the string's direction with {values['grasp_stiffness']:.3g} N m/(rad kg)"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the angle."""
        angle = np.linspace(-1.0, 1.0, 2)
        line(
            axes,
            angle,
            cls.grasp_moment(angle, values["grasp_stiffness"]),
            "angle at the grasp / rad",
            "moment / stiffness of a mass point",
        )

    @staticmethod
    def grasp_moment(angle: Quantity, grasp_stiffness: Quantity) -> Quantity:
        return grasp_stiffness * angle
