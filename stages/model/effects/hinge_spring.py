"""Elastic bending moment, F_b of Table 1."""

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class HingeSpring(StringEffect):
    """Moment proportional to curvature (Euler-Bernoulli). k_h, per mass point, is EI / (mu l^2)."""

    name = "hinge_spring"
    parameters = (
        Parameter("bending_stiffness", "N m/(rad kg)", "spring between segments", 8.0e-3, 4.0e2, 8.0e-3, "k_h", 2),
    )

    @staticmethod
    def moment(curvature: float, bending_stiffness: float) -> float:
        return bending_stiffness * curvature
