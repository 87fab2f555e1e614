"""Air drag that is larger across the string than along it."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    brakes,
    draw_line,
    is_odd,
    rotates_with,
    vanishes_at_zero,
)


class AnisotropicDrag(StringEffect):
    """Additional air drag on velocity across the string: `excess` times the paper's."""

    name = "anisotropic_drag"
    parameters = (
        Parameter(
            "excess",
            "1",
            "relative excess of drag across the string over drag along it",
            0.0,
            10.0,
            0.0,
        ),
    )
    reference = (
        "Taylor, Analysis of the swimming of long and narrow animals (1952): drag "
        "along and across a cylinder"
    )
    invariants = (
        is_odd("load", "ux", "uy"),
        rotates_with("load", "u", "t"),
        vanishes_at_zero("load", "ux", "uy"),
        brakes("load", "ux", "uy"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"air resists motion across the string {1 + values['excess']:.2f} times as "
            f"much as along it"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the drag over the angle between velocity and string."""
        angle = np.linspace(0.0, np.pi, 181)
        fx, fy = cls.load(
            1.0, 0.0, np.cos(angle), np.sin(angle), 1.0, 0.0, values["excess"]
        )
        resistance = np.hypot(fx - 1.0, fy)
        draw_line(
            axes,
            np.degrees(angle),
            resistance,
            "between velocity and string / degrees",
            "resistance / along",
        )

    @staticmethod
    def load(
        ux: Quantity,
        uy: Quantity,
        tx: Quantity,
        ty: Quantity,
        linear_drag: Quantity,
        quadratic_drag: Quantity,
        excess: Quantity,
    ) -> tuple[Quantity, Quantity]:
        drag = excess * (linear_drag + quadratic_drag * np.sqrt(ux * ux + uy * uy))
        along = ux * tx + uy * ty
        return -drag * (ux - along * tx), -drag * (uy - along * ty)
