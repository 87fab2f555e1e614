"""Elastic moment between hand and string, F_ph of Table 1."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
)


class GraspSpring(StringEffect):
    """Moment proportional to the angle between the grasp's direction and the string.

    k_ph in the paper.
    """

    name = "grasp_spring"
    parameters = (
        Parameter(
            "grasp_stiffness",
            "N m/(rad kg)",
            "spring moment at the grasp",
            1.0e-3,
            5.0,
            1.0e-3,
            "k_ph",
            1,
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_ph"
    invariants = (is_odd("grasp_moment", "angle"),)

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"the grasp holds the string's direction with "
            f"{values['grasp_stiffness']:.3g} N m/(rad kg)"
        )

    @staticmethod
    def grasp_moment(angle: Quantity, grasp_stiffness: Quantity) -> Quantity:
        return grasp_stiffness * angle
