"""A wrong scale of metres per pixel."""

import numpy as np

from stringcast.stages.model.effect import (
    Camera,
    CameraEffect,
    Parameter,
    Quantity,
    Values,
    is_odd,
)


class PixelScale(CameraEffect):
    """A scale error: reported points are scaled about the world's origin."""

    name = "pixel_scale"
    uses_velocity = False
    order = 2  # last, where pixels become metres
    parameters = (
        Parameter("excess", "1", "relative error of reported sizes", -0.1, 0.1, 0.0),
    )
    reference = "Hartley and Zisserman, Multiple View Geometry (2004), 2.4: similarity"
    invariants = (is_odd("observe", "points"),)

    @staticmethod
    def describe(values: Values) -> str:
        size = "large" if values["excess"] > 0 else "small"
        return (
            f"the camera's scale is wrong: everything is reported "
            f"{100 * abs(values['excess']):.2f} % too {size}"
        )

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        excess: Quantity,
    ) -> np.ndarray:
        """Return the scaled points."""
        return points * (1 + excess)
