"""Damping moment between hand and string, F_phc of Table 1."""

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class GraspDamper(StringEffect):
    """Moment proportional to the rate of the angle at the grasp. c_ph in the paper."""

    name = "grasp_damper"
    parameters = (
        Parameter("grasp_damping", "N m s/(rad kg)", "damper moment at the grasp", 1.1e-6, 0.37, 1.1e-6, "c_ph", 1),
    )

    @staticmethod
    def grasp_moment(rate: float, grasp_damping: float) -> float:
        return grasp_damping * rate
