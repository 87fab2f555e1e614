"""Relaxation of part of the bending stiffness."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
)


class StandardLinearSolid(StringEffect):
    """A spring in series with a damper, in parallel with the bending stiffness (Zener).

    It is stiff in fast motion and soft in slow motion. Several in parallel are a Prony
    series. Within one cast it resembles damping.
    """

    name = "standard_linear_solid"
    parameters = (
        Parameter(
            "stiffness",
            "m4/s2",
            "bending stiffness over mass per length that relaxes",
            0.0,
            3.0,
            0.0,
        ),
        Parameter("relaxation", "s", "time in which it relaxes", 3e-3, 3.0, 0.1),
    )
    reference = (
        "Zener, Elasticity and Anelasticity of Metals (1948); Christensen, Theory of "
        "Viscoelasticity (1982), 1.6"
    )
    invariants = (
        is_odd("hinge_memory", "memory", "change"),
        is_odd("hinge_memory_moment", "memory"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"bending relaxes: {values['stiffness']:.2g} m4/s2 of its stiffness within "
            f"{values['relaxation']:.2g} s"
        )

    @staticmethod
    def hinge_memory(
        memory: Quantity, change: Quantity, dt: Quantity, relaxation: Quantity
    ) -> Quantity:
        decay = 1.0 / (relaxation / dt + 0.5)  # trapezoidal rule
        return memory * (1.0 - decay) + change * (1.0 - 0.5 * decay)

    @staticmethod
    def hinge_memory_moment(memory: Quantity, stiffness: Quantity) -> Quantity:
        return stiffness * memory
