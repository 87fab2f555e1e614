"""Somebody takes hold of the string for a moment."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, moment


class Touch(StringEffect, Outside):
    """A short part of the string is held by a spring and a damper, at the place where
    it is then, and let go.
    """

    name = "touch"
    once = True
    parameters = (
        Parameter("grip", "1/s", "damping rate of what is held", 0.0, 300.0, 0.0),
        Parameter("where", "m", "arc length of what is held", 0.0, 1.0, 0.2),
        Parameter("when", "s", "middle of the time it is held", 0.0, 2.0, 0.3),
        Parameter("lasts", "s", "half that time", 0.02, 0.1, 0.04),
        Parameter("place_x", "m", "where it is held", -1.5, 1.5, 0.0),
        Parameter("place_y", "m", "where it is held", -1.5, 1.5, 0.0),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"somebody holds the string {values['where']:.2f} m from the grasp at {values['when']:.2f} s"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """Some time during the motion, on the outer half, where that is when it begins."""
        when, lasts = moment(rng, t), float(rng.uniform(0.025, 0.05))
        point = int(rng.uniform(0.45, 0.95) * points.shape[1])
        along = np.linalg.norm(np.diff(points[0, : point + 1], axis=0), axis=1).sum()
        x, y = (float(np.interp(when - lasts / 2, t, c)) for c in points[:, point].T)
        return {
            "where": float(along),
            "when": when,
            "lasts": lasts,
            "place_x": x,
            "place_y": y,
        }

    @staticmethod
    def bound(grip: Quantity, **others: Quantity) -> tuple[Quantity, Quantity]:
        """The spring is that which the damper lets go in 30 ms."""
        return grip * 30.0, grip

    @staticmethod
    def load(
        x: Quantity,
        y: Quantity,
        vx: Quantity,
        vy: Quantity,
        s: Quantity,
        t: Quantity,
        grip: Quantity,
        where: Quantity,
        when: Quantity,
        lasts: Quantity,
        place_x: Quantity,
        place_y: Quantity,
    ) -> tuple[Quantity, Quantity]:
        z, w = (t - when) / lasts, (s - where) / 0.03  # [m]
        held = grip * np.maximum(1.0 - z * z, 0.0) * np.maximum(1.0 - w * w, 0.0)
        return -held * (vx + 30.0 * (x - place_x)), -held * (vy + 30.0 * (y - place_y))
