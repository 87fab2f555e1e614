"""Rows that are exposed one after another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stages.model.effect import CameraEffect, Quantity
from stages.model.parameter import Parameter
from stages.model.picture import line
from stages.model.symmetry import unmoved

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from stages.model.camera import Camera


class RollingShutter(CameraEffect):
    """A row v of H is exposed (v / H - 1/2) `readout` after the frame's time; points go on evenly meanwhile."""

    name = "rolling_shutter"
    parameters = (
        Parameter("readout", "s", "time from the exposure of the top row to the bottom row", -0.02, 0.02, 0.0),
    )
    reference = "Meingast, Geyer and Sastry, Geometric models of rolling-shutter cameras (2005)"
    symmetries = (unmoved("seen", "points", "velocity"),)

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        order = "top to bottom" if values["readout"] > 0 else "bottom to top"
        return f"the shutter rolls: rows are exposed from {order} within {1e3 * abs(values['readout']):.2f} ms"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """When a row is exposed."""
        row = np.linspace(0.0, 1.0, 2)
        line(axes, row, values["readout"] * (row - 0.5), "row / height", "exposed after the frame's time / s")

    @staticmethod
    def seen(
        points: np.ndarray, velocity: np.ndarray, times: np.ndarray, camera: Camera, readout: Quantity
    ) -> np.ndarray:
        """Where each point is when its row is exposed: delay = readout (row + rowspeed delay), solved for the delay."""
        row = camera.pixels(points)[..., 1:] / camera.height - 0.5
        speed = -velocity[..., 1:] * camera.px_per_m / camera.height
        return points + velocity * readout * row / (1 - readout * speed)
