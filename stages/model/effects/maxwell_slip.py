"""Strands that stick together until they slip, with memory."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
    moment_percent_of_weight,
)


class MaxwellSlip(StringEffect):
    """A spring in series with dry friction, in parallel with the bending stiffness.

    It sticks, then slips at the moment `cap` (the stop operator of Prandtl and
    Ishlinskii). Its memory follows the curvature, clipped at +-slip. Its stiffness
    while sticking is cap / slip; several in parallel smooth the transition. If swings
    are much wider than `slip`, the data determine only the cap and an upper bound of
    `slip`.
    """

    name = "maxwell_slip"
    parameters = (
        Parameter(
            "cap",
            "m3/s2",
            "moment over mass per length at which it slips",
            0.0,
            0.3,
            0.0,
        ),
        Parameter(
            "slip", "1/m", "curvature from rest at which it slips", 5e-3, 2.0, 0.1
        ),
    )
    reference = (
        "Iwan, A distributed-element model for hysteresis and its steady-state "
        "dynamic response (1966)"
    )
    invariants = (
        is_odd("hinge_memory", "memory", "change"),
        is_odd("hinge_memory_moment", "memory"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        share = moment_percent_of_weight(values["cap"])
        return (
            f"strands stick and slip in bending, at {share:.1f} % of the moment that "
            f"holds 100 mm of the string level"
        )

    @staticmethod
    def derive_parameters(cap: Quantity, slip: Quantity) -> dict[str, Quantity]:
        """Return the stiffness while sticking [m4/s2]."""
        return {"sticking": cap / slip}

    @staticmethod
    def hinge_memory(memory: Quantity, change: Quantity, slip: Quantity) -> Quantity:
        # Not np.clip: it tests for NaN, which costs the loop a tenth.
        unclipped = memory + change
        return 0.5 * (abs(unclipped + slip) - abs(unclipped - slip))

    @staticmethod
    def hinge_memory_moment(memory: Quantity, sticking: Quantity) -> Quantity:
        return sticking * memory
