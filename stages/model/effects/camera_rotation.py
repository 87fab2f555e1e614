"""A roll of the camera about its axis."""

import numpy as np

from stringcast.stages.model.effect import (
    Camera,
    CameraEffect,
    Parameter,
    Quantity,
    Values,
    rotates_about_centre,
)


class CameraRotation(CameraEffect):
    """A counter-clockwise rotation of the reported points about the image centre."""

    name = "camera_rotation"
    uses_velocity = False
    parameters = (
        Parameter(
            "angle",
            "rad",
            "counter-clockwise rotation of reported points",
            -0.2,
            0.2,
            0.0,
        ),
    )
    reference = "Hartley and Zisserman, Multiple View Geometry (2004), 2.4: similarity"
    invariants = (rotates_about_centre("observe"),)

    @staticmethod
    def describe(values: Values) -> str:
        sense = "counter-clockwise" if values["angle"] > 0 else "clockwise"
        return (
            f"the camera is rolled: reported points are turned "
            f"{np.degrees(abs(values['angle'])):.2f} degrees {sense}"
        )

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        angle: Quantity,
    ) -> np.ndarray:
        """Return the points rotated about the image centre."""
        centre_x, centre_y = camera.centre
        x = points[..., 0] - centre_x
        y = points[..., 1] - centre_y
        c, s = np.cos(angle[..., 0]), np.sin(angle[..., 0])
        observed = np.empty_like(points)
        observed[..., 0] = centre_x + c * x - s * y
        observed[..., 1] = centre_y + s * x + c * y
        return observed
