"""Air resistance, F_c of Table 1."""

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


class AirDrag(StringEffect):
    """Air drag (C_c1 + C_c2 |u|) u against the velocity u in air, over mass."""

    name = "air_drag"
    parameters = (
        Parameter(
            "linear_drag",
            "N s/(m kg)",
            "air resistance, proportional",
            1.0e-4,
            10.0,
            1.0e-4,
            "C_c1",
        ),
        Parameter(
            "quadratic_drag",
            "N s2/(m2 kg)",
            "air resistance, squared",
            1.0e-4,
            10.0,
            1.0e-4,
            "C_c2",
        ),
    )
    reference = "Tabata, Seki, Tsuji and Hitamitsu (2021), Table 1: F_c"
    invariants = (
        is_odd("load", "ux", "uy"),
        rotates_with("load", "u"),
        vanishes_at_zero("load", "ux", "uy"),
        brakes("load", "ux", "uy"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"air resists with ({values['linear_drag']:.3g} + "
            f"{values['quadratic_drag']:.3g} |v|) v"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the force over speed."""
        speed = np.linspace(0.0, 20.0, 101)
        force = -cls.load(speed, 0.0, values["linear_drag"], values["quadratic_drag"])[
            0
        ]
        draw_line(axes, speed, force, "speed [m/s]", "air resistance [m/s2]")

    @staticmethod
    def load(
        ux: Quantity, uy: Quantity, linear_drag: Quantity, quadratic_drag: Quantity
    ) -> tuple[Quantity, Quantity]:
        drag = linear_drag + quadratic_drag * np.sqrt(ux * ux + uy * uy)
        return -drag * ux, -drag * uy
