"""A hand that trembles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import HandEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, direction


class Vibration(HandEffect, Outside):
    """The hand swings to and fro beside its path, from the start of the movement on,
    which no encoder shows.
    """

    name = "vibration"
    once = False
    parameters = (
        Parameter("amplitude", "m", "how far it swings to each side", 0.0, 0.02, 0.0),
        Parameter("frequency", "Hz", "how often", 5.0, 50.0, 15.0),
        Parameter("towards", "rad", "in which direction", -3.2, 3.2, 0.0),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"the hand trembles by {1e3 * values['amplitude']:.1f} mm at {values['frequency']:.0f} Hz"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """A frequency of a light structure."""
        return {"frequency": float(rng.uniform(8.0, 25.0)), "towards": direction(rng)}

    @staticmethod
    def grasp(
        t: np.ndarray,
        pose: np.ndarray,
        amplitude: Quantity,
        frequency: Quantity,
        towards: Quantity,
    ) -> np.ndarray:
        """The pose with a vibration that builds up within some 0.1 s."""
        after = np.maximum(t[:, None], 0.0)
        swing = (
            amplitude
            * np.sin(2 * np.pi * frequency * after)
            * (1 - np.exp(-((after / 0.1) ** 2)))
        )
        return pose + swing * np.concatenate(
            [np.cos(towards), np.sin(towards), 0 * towards], axis=-1
        )
