"""Damping along the string, F_d of Table 1."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
    resists,
)


class AxialDamper(StringEffect):
    """Tension proportional to the rate of stretch (Kelvin-Voigt), c_s in the paper."""

    name = "axial_damper"
    parameters = (
        Parameter(
            "axial_damping",
            "N s/(m kg)",
            "damping force between mass points",
            0.13,
            1.3e3,
            0.13,
            "c_s",
            2,
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_d"
    invariants = (
        is_odd("tension", "rate"),
        resists("tension"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return f"stretching is damped by {values['axial_damping']:.3g} N s/(m kg)"

    @staticmethod
    def tension(rate: Quantity, axial_damping: Quantity) -> Quantity:
        return axial_damping * rate
