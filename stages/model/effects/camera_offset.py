"""A wrong origin of the picture."""

import numpy as np

from stringcast.stages.model.effect import (
    Camera,
    CameraEffect,
    Parameter,
    Quantity,
    Values,
    shifts_with,
)


class CameraOffset(CameraEffect):
    """A shift of all reported points.

    The stated pixel of the arm's origin is wrong. `align` measures the shift
    beforehand.
    """

    name = "camera_offset"
    uses_velocity = False
    parameters = (
        Parameter(
            "x", "m", "shift of all reported points to the right", -0.1, 0.1, 0.0
        ),
        Parameter("y", "m", "upward shift of all reported points", -0.1, 0.1, 0.0),
    )
    reference = "Hartley and Zisserman, Multiple View Geometry (2004), 2.4: similarity"
    invariants = (shifts_with("observe", "points"),)

    @staticmethod
    def describe(values: Values) -> str:
        side = "right" if values["x"] > 0 else "left"
        across = f"{1e3 * abs(values['x']):.1f} mm to the {side}"
        up = f"{1e3 * abs(values['y']):.1f} mm {'up' if values['y'] > 0 else 'down'}"
        return (
            f"the picture's origin is wrong: everything is reported {across} and {up}"
        )

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        x: Quantity,
        y: Quantity,
    ) -> np.ndarray:
        """Return the shifted points."""
        return points + np.concatenate([x, y], axis=-1)
