"""Strands that rub on one another: bending hysteresis with memory and round corners."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    moment_percent_of_weight,
    odd,
)


class DahlFriction(StringEffect):
    """Dahl's friction beside the bending stiffness: the moment comes near to `cap` as
    the hinge bends on one way.

    It is to `maxwell_slip` what a worn edge is to a sharp one: at a reversal it is one
    to two times cap / slip stiff. No swing tells the two apart that goes far beyond
    `slip`.
    """

    name = "dahl_friction"
    parameters = (
        Parameter(
            "cap",
            "m3/s2",
            "moment over mass per length that it comes near to",
            0.0,
            0.3,
            0.0,
        ),
        Parameter(
            "slip", "1/m", "curvature over which it comes near to it", 5e-3, 2.0, 0.1
        ),
    )
    reference = "Dahl, Solid friction damping of mechanical vibrations (1976)"
    invariants = (odd("held", "held", "change"), odd("held_moment", "held"))

    @staticmethod
    def describe(values: Values) -> str:
        share = moment_percent_of_weight(values["cap"])
        return f"bending rubs, with {share:.1f} % of the moment that holds 100 mm of it out level"

    @staticmethod
    def derive_parameters(cap: Quantity, slip: Quantity) -> dict[str, Quantity]:
        """Stiffness from rest [m4/s2], and one over the curvature at which it slips
        [m].
        """
        return {"sticking": cap / slip, "per_slip": 1 / slip}

    @staticmethod
    def held(held: Quantity, change: Quantity, per_slip: Quantity) -> Quantity:
        x = abs(change) * per_slip
        # (exp(x) - 1) / x, within a step to the last digit, by products: a division by
        # 3 stays one in the loop
        rise = 1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x * (1.0 / 24.0)))
        return (held + change * rise) / (1.0 + x * rise)

    @staticmethod
    def held_moment(held: Quantity, sticking: Quantity) -> Quantity:
        return sticking * held
