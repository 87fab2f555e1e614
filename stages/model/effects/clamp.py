"""A string that does not begin at the stated grasp."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    draw_line,
)


class Clamp(StringEffect):
    """A free string that begins `hidden` before the stated grasp, shifted sideways.

    Without an offset it passes straight through the stated grasp. Measured points keep
    their arc length from the stated grasp. If `hidden` is negative, the held part is
    straight in the direction of the free string. The offset is in the frame of the
    grasp, including `grasp_angle`. An offset of the camera looks the same.
    """

    name = "clamp"
    parameters = (
        Parameter(
            "hidden", "m", "free string before the stated grasp", -0.03, 0.03, 0.0
        ),
        Parameter(
            "along",
            "m",
            "offset of the string in the grasp's direction",
            -0.01,
            0.01,
            0.0,
        ),
        Parameter(
            "across", "m", "offset of the string to the left of it", -0.01, 0.01, 0.0
        ),
    )
    reference = (
        "Geometry; strips of silicone measured on film hide 9 to 10 mm in their clamp "
        "(L4DC set)"
    )

    @staticmethod
    def describe(values: Values) -> str:
        side = "before" if values["hidden"] > 0 else "beyond"
        hidden, along, across = (
            1e3 * values[name] for name in ("hidden", "along", "across")
        )
        return (
            f"the free string begins {abs(hidden):.1f} mm {side} the stated grasp, "
            f"moved by {along:+.1f} mm along and {across:+.1f} mm across its direction"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the stated grasp and the beginning of the string."""
        axes.plot(0.0, 0.0, "+", markersize=12)
        along, across = cls.grasp_offset(**values)
        draw_line(
            axes,
            np.array([along, along + 0.05]),
            np.array([across, across]),
            "along the grasp [m]",
            "across [m]",
        )

    @staticmethod
    def hidden_length(hidden: Quantity) -> Quantity:
        return hidden

    @staticmethod
    def grasp_offset(
        hidden: Quantity, along: Quantity, across: Quantity
    ) -> tuple[Quantity, Quantity]:
        return along - hidden, across
