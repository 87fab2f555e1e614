"""A picture whose origin is elsewhere."""

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
    """A shift of everything that the camera reports.

    The pixel taken for the arm's origin is another one. `align` measures it beforehand.
    """

    name = "camera_offset"
    uses_velocity = False
    parameters = (
        Parameter("x", "m", "how far to the right everything is seen", -0.1, 0.1, 0.0),
        Parameter("y", "m", "how far up everything is seen", -0.1, 0.1, 0.0),
    )
    reference = "Hartley and Zisserman, Multiple View Geometry (2004), 2.4: similarity"
    invariants = (shifts_with("observe", "points"),)

    @staticmethod
    def describe(values: Values) -> str:
        side = "right" if values["x"] > 0 else "left"
        across = f"{1e3 * abs(values['x']):.1f} mm to the {side}"
        up = f"{1e3 * abs(values['y']):.1f} mm {'up' if values['y'] > 0 else 'down'}"
        return f"the picture's origin is off: everything is seen {across} and {up}"

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
        observed: np.ndarray = points + np.concatenate([x, y], axis=-1)
        return observed
