"""Damping in bending, F_h of Table 1."""

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class HingeDamper(StringEffect):
    """Moment proportional to the rate of curvature. c_h in the paper."""

    name = "hinge_damper"
    parameters = (
        Parameter("bending_damping", "N m s/(rad kg)", "damper between segments", 3.0e-7, 0.67, 3.0e-7, "c_h", 2),
    )

    @staticmethod
    def moment(rate: float, bending_damping: float) -> float:
        return bending_damping * rate
