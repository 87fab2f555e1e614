"""Elastic force along the string, F_s of Table 1."""

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class AxialSpring(StringEffect):
    """Tension proportional to stretch (Hooke). k_s, per mass point, is EA / (mu l^2)."""

    name = "axial_spring"
    parameters = (
        Parameter("axial_stiffness", "N/(m kg)", "elastic force between mass points", 9.0e3, 9.0e5, 9.0e3, "k_s", 2),
    )

    @staticmethod
    def tension(stretch: float, axial_stiffness: float) -> float:
        return axial_stiffness * stretch
