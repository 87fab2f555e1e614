"""Dry friction in bending: hysteresis that does not depend on how fast it bends."""

import numpy as np

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    even,
    moment_percent_of_weight,
    never_negative,
    vanishes_at_zero,
)


class InternalFriction(StringEffect):
    """A moment of constant size against the rate of curvature, smooth through rest.
    Retired for `maxwell_slip`.

    It keeps no memory: below 100/(m s) it is viscous, and the string creeps home where
    a dry one would stick. Runs that are stored and benches that are recorded mean it by
    its name; no diagnosis asks for it. Told as a drag, moment over rate, that falls as
    it bends faster.
    """

    name = "internal_friction"
    excluded_from_search = True
    parameters = (
        Parameter(
            "friction",
            "m3/s2",
            "dry friction moment over mass per length",
            0.0,
            0.05,
            0.0,
        ),
    )
    reference = "Coulomb friction, regularised; Dahl, Solid friction damping of mechanical vibrations (1976)"
    invariants = (
        even("hinge_drag", "rate"),
        vanishes_at_zero("hinge_drag", "friction"),
        never_negative("hinge_drag"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        share = moment_percent_of_weight(values["friction"])
        return f"bending has dry friction: {share:.1f} % of the moment that holds 100 mm of it out level"

    @staticmethod
    def hinge_drag(rate: Quantity, friction: Quantity) -> Quantity:
        slow = 100.0  # [1/(m s)]
        return friction / np.sqrt(rate * rate + slow * slow)
