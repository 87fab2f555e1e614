"""A steady flow of air through the workspace."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
)


class Wind(StringEffect):
    """A steady flow of air, relative to which drag acts.

    A draught in a room is 0.1 to 0.3 m/s; a fan near the arm may reach the end of the
    range.
    """

    name = "wind"
    parameters = (
        Parameter("along_x", "m/s", "velocity of the air to the right", -3.0, 3.0, 0.0),
        Parameter("along_y", "m/s", "velocity of the air upwards", -3.0, 3.0, 0.0),
    )
    reference = "Galilean invariance of air resistance"

    @staticmethod
    def describe(values: Values) -> str:
        # Components, because a direction has no interval.
        along_x, along_y = values["along_x"], values["along_y"]
        side = "right" if along_x > 0 else "left"
        vertical = "upwards" if along_y > 0 else "downwards"
        return (
            f"air flows through the workspace at {abs(along_x):.2f} m/s to the {side} "
            f"and {abs(along_y):.2f} m/s {vertical}"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw an arrow in the direction of the flow."""
        reach = 1.3 * max(np.hypot(values["along_x"], values["along_y"]), 0.01)
        axes.quiver(
            0,
            0,
            values["along_x"],
            values["along_y"],
            angles="xy",
            scale_units="xy",
            scale=1,
        )
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set_xlabel("air to the right [m/s]")
        axes.set_ylabel("air upwards [m/s]")

    @staticmethod
    def flow(along_x: Quantity, along_y: Quantity) -> tuple[Quantity, Quantity]:
        return along_x, along_y
