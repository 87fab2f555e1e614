"""A place that attracts the string."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, place


class Magnet(StringEffect, Outside):
    """Whatever is within reach is drawn to a place, or away from it; at the place
    itself nothing acts.
    """

    name = "magnet"
    once = False
    parameters = (
        Parameter(
            "force",
            "m/s2",
            "pull over mass where it is largest, about",
            -500.0,
            500.0,
            0.0,
        ),
        Parameter("centre_x", "m", "the place", -1.5, 1.5, 0.0),
        Parameter("centre_y", "m", "the place", -1.5, 1.5, 0.0),
        Parameter(
            "reach", "m", "distance beyond which nothing is felt", 0.05, 0.5, 0.15
        ),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"something at ({values['centre_x']:.2f}, {values['centre_y']:.2f}) m pulls at the string"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """A place that the string passes once it moves."""
        x, y = place(rng, points, 0.3, 0.7)
        return {"centre_x": x, "centre_y": y, "reach": float(rng.uniform(0.1, 0.2))}

    @staticmethod
    def load(
        x: Quantity,
        y: Quantity,
        force: Quantity,
        centre_x: Quantity,
        centre_y: Quantity,
        reach: Quantity,
    ) -> tuple[Quantity, Quantity]:
        dx, dy = (centre_x - x) / reach, (centre_y - y) / reach
        inside = np.maximum(1.0 - dx * dx - dy * dy, 0.0)
        pull = 3.5 * force * inside * inside
        return pull * dx, pull * dy
