"""Gravity that is not vertical in the arm's frame."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    vanishes_at_zero,
)


class GravityDirection(StringEffect):
    """A rotation of gravity, counter-clockwise: the arm's base is not level.

    A floor that slopes by more than 1 in 20 is a ramp (2010 ADA Standards, 403.3). The
    range is twice that, for the floor and for the base on it. The law is the
    acceleration to add to the paper's weight.
    """

    name = "gravity_direction"
    parameters = (
        Parameter("tilt", "rad", "angle of gravity from straight down", -0.1, 0.1, 0.0),
    )
    reference = "Rotation of a vector"
    invariants = (vanishes_at_zero("acceleration", "sine", "versine"),)

    @staticmethod
    def describe(values: Values) -> str:
        side = "right" if values["tilt"] > 0 else "left"
        return (
            f"gravity leans {np.degrees(abs(values['tilt'])):.1f} degrees to the "
            f"{side}: the base is not level"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw an arrow for gravity, and a grey line for the vertical."""
        axes.quiver(
            [0, 0],
            [0, 0],
            [0, np.sin(values["tilt"])],
            [-1, -np.cos(values["tilt"])],
            color=["0.7", "C0"],
            angles="xy",
            scale_units="xy",
            scale=1,
        )
        axes.set(xlim=(-0.6, 0.6), ylim=(-1.1, 0.1), aspect="equal")
        axes.set_xlabel("gravity to the right [9.81 m/s2]")
        axes.set_ylabel("upwards [9.81 m/s2]")

    @staticmethod
    def derive_parameters(tilt: Quantity) -> dict[str, Quantity]:
        """Return sine and versine, so that the loop has no sine."""
        return {"sine": np.sin(tilt), "versine": 2 * np.sin(tilt / 2) ** 2}

    @staticmethod
    def acceleration(sine: Quantity, versine: Quantity) -> tuple[Quantity, Quantity]:
        return 9.81 * sine, 9.81 * versine
