"""A camera that is knocked during a trial."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import CameraEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.outside import Outside, direction, moment

if TYPE_CHECKING:
    from stringcast.stages.model.camera import Camera


class BumpedCamera(CameraEffect, Outside):
    """A camera that is bumped: from one moment on everything is seen shifted."""

    name = "bumped_camera"
    once = True
    parameters = (
        Parameter("shift", "m", "how far", 0.0, 0.05, 0.0),
        Parameter("towards", "rad", "in which direction", -3.2, 3.2, 0.0),
        Parameter("when", "s", "from when on", 0.0, 2.0, 0.3),
    )

    @staticmethod
    def describe(values: Mapping[str, float]) -> str:
        return f"the camera is knocked at {values['when']:.2f} s and sees all shifted by {1e3 * values['shift']:.1f} mm"

    @staticmethod
    def circumstances(
        rng: np.random.Generator, t: np.ndarray, points: np.ndarray
    ) -> dict[str, float]:
        """Some time during the motion."""
        return {"towards": direction(rng), "when": moment(rng, t)}

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        shift: Quantity,
        towards: Quantity,
        when: Quantity,
    ) -> np.ndarray:
        """Within some 10 ms."""
        since = 0.5 * (1 + np.tanh((times[:, None, None] - when) / 0.005))
        return points + shift * since * np.concatenate(
            [np.cos(towards), np.sin(towards)], axis=-1
        )
