"""Friction between strands, with memory and a smooth onset of slip."""

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

    The moment approaches `cap` while the hinge bends in one direction. It is a smooth
    form of `maxwell_slip`: after a reversal the stiffness is one to two times cap /
    slip. Swings far beyond `slip` do not distinguish the two.
    """

    name = "dahl_friction"
    parameters = (
        Parameter(
            "cap",
            "m3/s2",
            "limit of the friction moment over mass per length",
            0.0,
            0.3,
            0.0,
        ),
        Parameter(
            "slip",
            "1/m",
            "curvature over which it approaches the limit",
            5e-3,
            2.0,
            0.1,
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
            f"strands rub in bending, with up to {share:.1f} % of the moment that "
            f"holds 100 mm of the string level"
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
        # (exp(x) - 1) / x, exact to the last digit for the x of a step. Constant
        # products, because the loop would divide by 3.
        rise = 1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x * (1.0 / 24.0)))
        return (memory + change * rise) / (1.0 + x * rise)

    @staticmethod
    def hinge_memory_moment(memory: Quantity, sticking: Quantity) -> Quantity:
        return sticking * memory
