"""Bending that stiffens or softens with curvature."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    draw_line,
    is_even,
    vanishes_at_zero,
)


class NonlinearBending(StringEffect):
    """M = B k sqrt(q + sqrt(1 + q^2)) with q = 2 h k^2 for curvature k.

    For small h k^2 it is B k (1 + h k^2). For large h k^2, M of a stiffening string (h
    > 0) grows like k^2, and M of a softening string approaches a limit. M never
    decreases with curvature, so the string stays stable in bending.
    """

    name = "nonlinear_bending"
    parameters = (
        Parameter(
            "hardening",
            "m2",
            "relative rise of stiffness with squared curvature",
            -5e-3,
            5e-3,
            0.0,
        ),
    )
    reference = (
        "Tabata, Seki, Tsuji and Hitamitsu (2021), V-D: large bending has nonlinear "
        "properties"
    )
    invariants = (
        is_even("hinge_stiffness", "curvature"),
        vanishes_at_zero("hinge_stiffness", "curvature"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        kind = "stiffens" if values["hardening"] > 0 else "softens"
        share = 100 * NonlinearBending.hinge_stiffness(20.0, 1.0, values["hardening"])
        return (
            f"bending {kind} with curvature: the moment at a radius of 50 mm is "
            f"{share:+.0f} % from the linear one"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the moment over the curvature, in units of the stiffness."""
        curvature = np.linspace(-40.0, 40.0, 201)
        moment = curvature * (
            1 + cls.hinge_stiffness(curvature, 1.0, values["hardening"])
        )
        draw_line(
            axes, curvature, moment, "curvature [1/m]", "moment / stiffness [1/m]"
        )

    @staticmethod
    def hinge_stiffness(
        curvature: Quantity, bending_stiffness: Quantity, hardening: Quantity
    ) -> Quantity:
        q = 2.0 * hardening * curvature * curvature
        return bending_stiffness * (np.sqrt(q + np.sqrt(1.0 + q * q)) - 1.0)
