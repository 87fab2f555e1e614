"""Damping in bending, F_h of Table 1."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
    resists,
)


class HingeDamper(StringEffect):
    """Moment proportional to the rate of curvature, c_h in the paper."""

    name = "hinge_damper"
    parameters = (
        Parameter(
            "bending_damping",
            "N m s/(rad kg)",
            "damper between segments",
            3.0e-7,
            0.67,
            3.0e-7,
            "c_h",
            2,
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_h"
    invariants = (
        is_odd("moment", "rate"),
        resists("moment"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return f"bending is damped by {values['bending_damping']:.3g} N m s/(rad kg)"

    @staticmethod
    def moment(rate: Quantity, bending_damping: Quantity) -> Quantity:
        return bending_damping * rate
