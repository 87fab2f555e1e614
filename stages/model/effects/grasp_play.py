"""A string that sticks in the gripper and turns there: play with a memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import loop
from stringcast.stages.model.symmetry import odd

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class GraspPlay(StringEffect):
    """The jaws hold the string's direction by dry friction, up to the moment `cap`, beside the grasp's spring.

    Below it they give by `slip` at most and spring back; beyond it the string turns between them, and stays turned as
    far as the spring lets it: play, whose ends are where it last slipped to. Whoever wants it names it: while it sticks
    it looks like a firmer grasp.
    """

    name = "grasp_play"
    told = True
    parameters = (
        Parameter("cap", "m3/s2", "moment over mass per length at which it turns in the jaws", 0.0, 0.3, 0.0),
        Parameter("slip", "rad", "angle by which the jaws give before", 5e-3, 0.5, 0.05),
    )
    reference = "Iwan, A distributed-element model for hysteresis and its steady-state dynamic response (1966)"
    symmetries = (odd("grasp_held", "held", "change"), odd("grasp_held_moment", "held"))

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        share = 100 * values["cap"] / (9.81 * 0.1**2 / 2)
        return f"the string turns in the gripper, beyond {share:.1f} % of the moment that holds 100 mm of it out level"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """A loop, out to three times the angle at which it slips."""
        loop(axes, cls, values, 3 * values["slip"], 1.0)

    @staticmethod
    def grasp_held(held: Quantity, change: Quantity, slip: Quantity) -> Quantity:
        return np.minimum(np.maximum(held + change, -slip), slip)

    @staticmethod
    def grasp_held_moment(held: Quantity, cap: Quantity, slip: Quantity) -> Quantity:
        return cap * held / slip
