"""A string that sticks or turns in the gripper: dry friction with memory."""

import numpy as np

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    is_odd,
    moment_percent_of_weight,
)


class GraspPlay(StringEffect):
    """Jaws that hold the string's direction by dry friction, up to the moment `cap`.

    The friction is in parallel with the grasp's spring. Below `cap` the jaws yield
    elastically, by `slip` at most. Beyond it the string turns between them, and the
    spring only partly turns it back. While it sticks, the grasp looks firmer.
    """

    name = "grasp_play"
    parameters = (
        Parameter(
            "cap",
            "m3/s2",
            "moment over mass per length at which it turns in the jaws",
            0.0,
            0.3,
            0.0,
        ),
        Parameter(
            "slip", "rad", "angle by which the jaws yield before", 5e-3, 0.5, 0.05
        ),
    )
    reference = (
        "Iwan, A distributed-element model for hysteresis and its steady-state "
        "dynamic response (1966)"
    )
    invariants = (
        is_odd("grasp_memory", "memory", "change"),
        is_odd("grasp_memory_moment", "memory"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        share = moment_percent_of_weight(values["cap"])
        return (
            f"the string turns in the gripper, beyond {share:.1f} % of the moment that "
            f"holds 100 mm of it level"
        )

    @staticmethod
    def grasp_memory(memory: Quantity, change: Quantity, slip: Quantity) -> Quantity:
        return np.minimum(np.maximum(memory + change, -slip), slip)

    @staticmethod
    def grasp_memory_moment(
        memory: Quantity, cap: Quantity, slip: Quantity
    ) -> Quantity:
        return cap * memory / slip
