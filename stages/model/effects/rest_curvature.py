"""Permanent set: the string is curved at rest."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    draw_line,
    is_odd,
)


class RestCurvature(StringEffect):
    """A curvature without moment, positive to the left towards the tip.

    It is `curvature` in the middle of the string and changes linearly along it.
    """

    name = "rest_curvature"
    parameters = (
        Parameter(
            "curvature", "1/m", "curvature at rest in the middle", -20.0, 20.0, 0.0
        ),
        Parameter(
            "slope",
            "1/m2",
            "rise of the curvature at rest along the string",
            -100.0,
            100.0,
            0.0,
        ),
    )
    varies_between_trials = True
    reference = (
        "Antman, Nonlinear Problems of Elasticity (2005), 4.1: intrinsic curvature of "
        "a rod"
    )
    invariants = (is_odd("rest_curvature", "curvature", "slope"),)

    @staticmethod
    def describe(values: Values) -> str:
        side = "left" if values["curvature"] > 0 else "right"
        radius = 1e3 / max(abs(values["curvature"]), 1e-9)
        along = (
            f", and {values['slope'] / 10:+.2g}/m more every 100 mm"
            if values["slope"]
            else ""
        )
        return (
            f"the string has a permanent set: at rest it curves to the {side} with a "
            f"radius of {radius:.0f} mm{along}"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw 0.3 m of the string at rest."""
        s = np.linspace(0.0, 0.3, 101)
        turned = (values["curvature"] + values["slope"] * (s - s[-1]) / 2) * s
        steps = 0.003 * np.stack([np.cos(turned), np.sin(turned)])
        x, y = np.cumsum(steps, axis=1)
        draw_line(axes, x, y, "along the grasp [m]", "across [m]")

    @staticmethod
    def rest_curvature(
        curvature: Quantity, slope: Quantity, s: Quantity, length: Quantity
    ) -> Quantity:
        return curvature + slope * (s - 0.5 * length)
