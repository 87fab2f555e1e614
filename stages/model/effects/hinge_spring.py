"""Elastic bending moment, F_b of Table 1."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
)


class HingeSpring(StringEffect):
    """Moment proportional to curvature (Euler-Bernoulli).

    k_h, per mass point, is EI / (mu l^2).
    """

    name = "hinge_spring"
    parameters = (
        Parameter(
            "bending_stiffness",
            "N m/(rad kg)",
            "spring between segments",
            8.0e-3,
            4.0e2,
            8.0e-3,
            "k_h",
            2,
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_b"
    invariants = (is_odd("moment", "curvature"),)

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"the string bends with a stiffness of {values['bending_stiffness']:.3g} N "
            f"m/(rad kg)"
        )

    @staticmethod
    def moment(curvature: Quantity, bending_stiffness: Quantity) -> Quantity:
        return bending_stiffness * curvature
