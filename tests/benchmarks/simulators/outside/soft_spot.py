"""A place where the string bends more easily."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside


class SoftSpot(StringEffect, Outside):
    """Bending stiffness is lost over a few centimetres, as where a cord was crushed."""

    name = "soft_spot"
    once = False
    parameters = (
        Parameter(
            "loss",
            "1",
            "share of the stiffness that is lost in the middle",
            0.0,
            0.98,
            0.0,
        ),
        Parameter("where", "m", "arc length of the middle", 0.0, 1.0, 0.15),
        Parameter("width", "m", "half its extent", 0.02, 0.1, 0.05),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"the string has lost {100 * values['loss']:.0f} % of its stiffness {values['where']:.2f} m from the grasp"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """About the middle of the string."""
        length = float(np.linalg.norm(np.diff(points[0], axis=0), axis=1).sum())
        return {
            "where": float(rng.uniform(0.35, 0.65) * length),
            "width": float(rng.uniform(0.04, 0.07)),
        }

    @staticmethod
    def moment(
        curvature: Quantity,
        bending_stiffness: Quantity,
        loss: Quantity,
        where: Quantity,
        width: Quantity,
        s: Quantity = 0.0,
    ) -> Quantity:
        # The search for a stable step gives no place: at the grasp the string is as
        # stiff as it gets.
        z = (s - where) / width
        inside = np.maximum(1.0 - z * z, 0.0)
        return -loss * inside * inside * bending_stiffness * curvature
