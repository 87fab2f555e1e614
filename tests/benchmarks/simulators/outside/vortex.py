"""Air that goes round."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, place


class Vortex(StringEffect, Outside):
    """Air turns about a place: a fan, or a machine nearby. At the place and beyond its
    reach it rests.
    """

    name = "vortex"
    once = False
    parameters = (
        Parameter(
            "speed",
            "m/s",
            "velocity of the air where it is largest, about",
            -40.0,
            40.0,
            0.0,
        ),
        Parameter("centre_x", "m", "the place", -1.5, 1.5, 0.0),
        Parameter("centre_y", "m", "the place", -1.5, 1.5, 0.0),
        Parameter("reach", "m", "distance beyond which it rests", 0.05, 1.0, 0.3),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"air turns about ({values['centre_x']:.2f}, {values['centre_y']:.2f}) m at {values['speed']:.1f} m/s"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """About a place where the string comes by."""
        x, y = place(rng, points, 0.0, 1.0)
        return {"centre_x": x, "centre_y": y, "reach": float(rng.uniform(0.2, 0.4))}

    @staticmethod
    def flow(
        x: Quantity,
        y: Quantity,
        speed: Quantity,
        centre_x: Quantity,
        centre_y: Quantity,
        reach: Quantity,
    ) -> tuple[Quantity, Quantity]:
        dx, dy = (x - centre_x) / reach, (y - centre_y) / reach
        inside = np.maximum(1.0 - dx * dx - dy * dy, 0.0)
        turn = 3.5 * speed * inside * inside
        return -turn * dy, turn * dx
