"""Damping moment between hand and string, F_phc of Table 1."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
    resists,
)


class GraspDamper(StringEffect):
    """Moment proportional to the rate of the angle at the grasp, c_ph in the paper."""

    name = "grasp_damper"
    parameters = (
        Parameter(
            "grasp_damping",
            "N m s/(rad kg)",
            "damper moment at the grasp",
            1.1e-6,
            0.37,
            1.1e-6,
            "c_ph",
            1,
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_phc"
    invariants = (
        is_odd("grasp_moment", "rate"),
        resists("grasp_moment"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"turning in the grasp is damped by {values['grasp_damping']:.3g} N m "
            f"s/(rad kg)"
        )

    @staticmethod
    def grasp_moment(rate: Quantity, grasp_damping: Quantity) -> Quantity:
        return grasp_damping * rate
