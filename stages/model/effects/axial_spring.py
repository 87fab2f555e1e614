"""Elastic force along the string, F_s of Table 1."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
)


class AxialSpring(StringEffect):
    """Tension proportional to stretch (Hooke).

    k_s, per mass point, is EA / (mu l^2).
    """

    name = "axial_spring"
    parameters = (
        Parameter(
            "axial_stiffness",
            "N/(m kg)",
            "elastic force between mass points",
            9.0e3,
            9.0e5,
            9.0e3,
            "k_s",
            2,
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_s"
    invariants = (is_odd("tension", "stretch"),)

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"the string stretches with a stiffness of {values['axial_stiffness']:.3g} "
            f"N/(m kg)"
        )

    @staticmethod
    def tension(stretch: Quantity, axial_stiffness: Quantity) -> Quantity:
        return axial_stiffness * stretch
