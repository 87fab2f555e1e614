"""A camera that is rolled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.effect import CameraEffect, Quantity
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import grid
from stringcast.stages.model.symmetry import turns_about_centre

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from stringcast.stages.model.camera import Camera


class CameraRotation(CameraEffect):
    """What is seen is turned about the middle of the image, counter-clockwise."""

    name = "camera_rotation"
    parameters = (Parameter("angle", "rad", "angle by which what is seen is turned", -0.2, 0.2, 0.0),)
    reference = "Hartley and Zisserman, Multiple View Geometry (2004), 2.4: similarity"
    symmetries = (turns_about_centre("seen"),)

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        way = "counter-clockwise" if values["angle"] > 0 else "clockwise"
        return f"the camera is rolled: what it sees is turned {np.degrees(abs(values['angle'])):.2f} degrees {way}"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """A square grid as it is seen."""
        grid(axes, cls.seen, **values)

    @staticmethod
    def seen(
        points: np.ndarray, velocity: np.ndarray, times: np.ndarray, camera: Camera, angle: Quantity
    ) -> np.ndarray:
        """Turned about the centre."""
        x, y = np.moveaxis(points - camera.centre, -1, 0)
        c, s = np.cos(angle[..., 0]), np.sin(angle[..., 0])
        return camera.centre + np.stack([c * x - s * y, s * x + c * y], axis=-1)
