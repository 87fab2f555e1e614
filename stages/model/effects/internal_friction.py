"""Dry friction in bending: hysteresis that does not depend on how fast it bends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line
from stringcast.stages.model.symmetry import even, never_negative, nothing_at_zero

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class InternalFriction(StringEffect):
    """A moment of constant size against the rate of curvature, smooth through rest; it keeps no memory.

    Below 100/(m s), slow for a cast, it is viscous: the string creeps home where a dry one would stick. Told as a drag,
    moment over rate, that falls as it bends faster.
    """

    name = "internal_friction"
    parameters = (Parameter("friction", "m3/s2", "dry friction moment over mass per length", 0.0, 0.05, 0.0),)
    reference = "Coulomb friction, regularised; Dahl, Solid friction damping of mechanical vibrations (1976)"
    symmetries = (even("hinge_drag", "rate"), nothing_at_zero("hinge_drag", "friction"), never_negative("hinge_drag"))

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        share = 100 * values["friction"] / (9.81 * 0.1**2 / 2)
        return f"bending has dry friction: {share:.1f} % of the moment that holds 100 mm of it out level"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """Over the rate of curvature."""
        rate = np.linspace(-1000.0, 1000.0, 401)
        moment = rate * cls.hinge_drag(rate, values["friction"])
        line(axes, rate, moment, "rate of curvature / (1/(m s))", "moment / (m3/s2)")

    @staticmethod
    def hinge_drag(rate: Quantity, friction: Quantity) -> Quantity:
        slow = 100.0  # [1/(m s)]
        return friction / np.sqrt(rate * rate + slow * slow)
