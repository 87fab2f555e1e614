"""Elastic moment between hand and string, F_ph of Table 1."""

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class GraspSpring(StringEffect):
    """Moment proportional to the angle between the grasp's direction and the string. k_ph in the paper."""

    name = "grasp_spring"
    parameters = (
        Parameter("grasp_stiffness", "N m/(rad kg)", "spring moment at the grasp", 1.0e-3, 5.0, 1.0e-3, "k_ph", 1),
    )

    @staticmethod
    def grasp_moment(angle: float, grasp_stiffness: float) -> float:
        return grasp_stiffness * angle
