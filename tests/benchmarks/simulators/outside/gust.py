"""A gust in one trial."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, direction, moment


class Gust(StringEffect, Outside):
    """The air moves everywhere, for a tenth of a second or two."""

    name = "gust"
    once = True
    parameters = (
        Parameter("speed", "m/s", "largest velocity of the air", 0.0, 40.0, 0.0),
        Parameter("towards", "rad", "direction of the flow", -3.2, 3.2, 0.0),
        Parameter("when", "s", "middle of the gust", 0.0, 2.0, 0.3),
        Parameter("lasts", "s", "half its duration", 0.02, 0.3, 0.1),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"a gust of {values['speed']:.1f} m/s blows at {values['when']:.2f} s"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """Some time during the motion, from anywhere."""
        return {
            "towards": direction(rng),
            "when": moment(rng, t),
            "lasts": float(rng.uniform(0.05, 0.12)),
        }

    @staticmethod
    def derive_parameters(
        speed: Quantity, towards: Quantity, **others: Quantity
    ) -> dict[str, Quantity]:
        """The largest velocity, in x and y."""
        return {
            "largest_x": speed * np.cos(towards),
            "largest_y": speed * np.sin(towards),
        }

    @staticmethod
    def flow(
        t: Quantity,
        largest_x: Quantity,
        largest_y: Quantity,
        when: Quantity,
        lasts: Quantity,
    ) -> tuple[Quantity, Quantity]:
        z = (t - when) / lasts
        inside = np.maximum(1.0 - z * z, 0.0)
        return largest_x * inside * inside, largest_y * inside * inside
