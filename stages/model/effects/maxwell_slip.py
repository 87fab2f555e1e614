"""Strands that stick to one another until they slip: bending hysteresis with memory."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    moment_percent_of_weight,
    odd,
)


class MaxwellSlip(StringEffect):
    """A spring in series with dry friction beside the bending stiffness: it sticks,
    then slips at the moment `cap`.

    The stop of Prandtl and Ishlinskii: it follows the curvature and is cut off at
    +-slip. Its stiffness while it sticks is cap / slip; several side by side round its
    corner. Where swings are far wider than `slip`, the data tell only the cap, and of
    `slip` an upper bound.
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
    reference = "Iwan, A distributed-element model for hysteresis and its steady-state dynamic response (1966)"
    invariants = (odd("held", "held", "change"), odd("held_moment", "held"))

    @staticmethod
    def describe(values: Values) -> str:
        share = moment_percent_of_weight(values["cap"])
        return f"bending sticks and slips, with {share:.1f} % of the moment that holds 100 mm of it out level"

    @staticmethod
    def derive_parameters(cap: Quantity, slip: Quantity) -> dict[str, Quantity]:
        """Stiffness of the element while it sticks [m4/s2]."""
        return {"sticking": cap / slip}

    @staticmethod
    def held(held: Quantity, change: Quantity, slip: Quantity) -> Quantity:
        # cut off by sizes: np.clip looks for NaN, which costs the loop a tenth
        wanted = held + change
        return 0.5 * (abs(wanted + slip) - abs(wanted - slip))

    @staticmethod
    def held_moment(held: Quantity, sticking: Quantity) -> Quantity:
        return sticking * held
