"""Trials from a simulation whose mass points are all equal."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    draw_line,
    vanishes_at_zero,
)


class EqualPoints(StringEffect):
    """Extra mass and drag at the tip, equal to those of half a segment.

    The last of n equal points has them. They occur in simulated trials, such as Eq. 1
    with its ten points, and not in filmed ones.
    """

    name = "equal_points"
    parameters = (
        Parameter(
            "excess",
            "1",
            "additional length at the tip over the string's length",
            0.0,
            0.06,
            0.0,
            typical_size=0.03,  # of 18 points
        ),
    )
    reference = "Tabata et al., IROS 2021, Eq. 1: every mass point has the same mass"
    invariants = (vanishes_at_zero("tip_length", "excess"),)

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"the measured string behaves as a chain of about "
            f"{1 + 0.5 / max(values['excess'], 1e-9):.0f} equal mass points"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the excess over the number of equal points, and its estimate."""
        points = np.arange(9, 101)
        draw_line(
            axes,
            points,
            0.5 / (points - 1),
            "equal mass points",
            "additional / string's length",
        )
        axes.axhline(values["excess"], linestyle=":", color="0.5")

    @staticmethod
    def tip_length(length: Quantity, excess: Quantity) -> Quantity:
        return excess * length
