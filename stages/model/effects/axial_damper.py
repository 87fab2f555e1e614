"""Damping along the string, F_d of Table 1."""

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class AxialDamper(StringEffect):
    """Tension proportional to the rate of stretch (Kelvin-Voigt). c_s in the paper."""

    name = "axial_damper"
    parameters = (
        Parameter("axial_damping", "N s/(m kg)", "damping force between mass points", 0.13, 1.3e3, 0.13, "c_s", 2),
    )

    @staticmethod
    def tension(rate: float, axial_damping: float) -> float:
        return axial_damping * rate
