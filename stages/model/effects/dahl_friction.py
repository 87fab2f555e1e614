"""Strands that rub on one another, with memory and round corners."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
    moment_percent_of_weight,
)


class DahlFriction(StringEffect):
    """Dahl's friction in parallel with the bending stiffness.

    The moment approaches `cap` as the hinge keeps bending one way. It is to
    `maxwell_slip` what a worn edge is to a sharp one: at a reversal its stiffness is
    one to two times cap / slip. No swing that goes far beyond `slip` distinguishes the
    two.
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
    invariants = (
        is_odd("hinge_memory", "memory", "change"),
        is_odd("hinge_memory_moment", "memory"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        share = moment_percent_of_weight(values["cap"])
        return (
            f"bending rubs, with {share:.1f} % of the moment that holds 100 mm of it "
            f"out level"
        )

    @staticmethod
    def derive_parameters(cap: Quantity, slip: Quantity) -> dict[str, Quantity]:
        """Return the stiffness from rest [m4/s2], and one over the slip [m]."""
        return {"sticking": cap / slip, "per_slip": 1 / slip}

    @staticmethod
    def hinge_memory(
        memory: Quantity, change: Quantity, per_slip: Quantity
    ) -> Quantity:
        x = abs(change) * per_slip
        # (exp(x) - 1) / x, within a step to the last digit, by products: a division by
        # 3 stays one in the loop
        rise = 1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x * (1.0 / 24.0)))
        return (memory + change * rise) / (1.0 + x * rise)

    @staticmethod
    def hinge_memory_moment(memory: Quantity, sticking: Quantity) -> Quantity:
        return sticking * memory
