"""Extra mass at the tip: a knot, a weight."""

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


class TipMass(StringEffect):
    """A point mass on the last mass point, relative to the string's mass."""

    name = "tip_mass"
    parameters = (
        Parameter(
            "ratio", "1", "mass at the tip over that of the string", 0.0, 1.0, 0.0
        ),
    )
    reference = "Newton's second law for a point mass at the end of a string"
    invariants = (vanishes_at_zero("tip_mass", "ratio"),)

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"a mass of {100 * values['ratio']:.1f} % of the string's sits at the tip"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the mass that a hanging string carries at each place."""
        s = np.linspace(0.0, 1.0, 101)
        draw_line(
            axes,
            s,
            1 - s + cls.tip_mass(1.0, values["ratio"]),
            "arc length / length",
            "mass beyond / string's",
        )

    @staticmethod
    def tip_mass(length: Quantity, ratio: Quantity) -> Quantity:
        return ratio * length
