"""A push at one moment."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, direction, moment


class Pulse(StringEffect, Outside):
    """A short force in one direction on a short part of the string, as when something
    hits it.
    """

    name = "pulse"
    once = True
    parameters = (
        Parameter("force", "m/s2", "largest force over mass", 0.0, 2000.0, 0.0),
        Parameter("towards", "rad", "its direction", -3.2, 3.2, 0.0),
        Parameter("when", "s", "middle of the pulse", 0.0, 2.0, 0.3),
        Parameter("where", "m", "arc length at which it acts", 0.0, 1.0, 0.2),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"something hits the string at {values['when']:.2f} s, {values['where']:.2f} m from the grasp"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """Some time during the motion, somewhere on the outer half."""
        length = float(np.linalg.norm(np.diff(points[0], axis=0), axis=1).sum())
        where = float(rng.uniform(0.45, 0.9) * length)
        return {"towards": direction(rng), "when": moment(rng, t), "where": where}

    @staticmethod
    def derive_parameters(
        force: Quantity, towards: Quantity, **others: Quantity
    ) -> dict[str, Quantity]:
        """The largest force, in x and y."""
        return {
            "largest_x": force * np.cos(towards),
            "largest_y": force * np.sin(towards),
        }

    @staticmethod
    def load(
        s: Quantity,
        t: Quantity,
        largest_x: Quantity,
        largest_y: Quantity,
        when: Quantity,
        where: Quantity,
    ) -> tuple[Quantity, Quantity]:
        z, w = (t - when) / 0.01, (s - where) / 0.04  # [s], [m]
        inside = np.maximum(1.0 - z * z, 0.0) * np.maximum(1.0 - w * w, 0.0)
        return largest_x * inside * inside, largest_y * inside * inside
