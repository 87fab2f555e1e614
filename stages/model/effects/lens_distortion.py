"""Radial distortion that is not corrected."""

import numpy as np

from stringcast.stages.model.effect import (
    Camera,
    CameraEffect,
    Parameter,
    Quantity,
    Values,
    rotates_about_centre,
)


class LensDistortion(CameraEffect):
    """Radial distortion r' = r (1 + k r^2) beyond what the camera corrects.

    r is the distance from the image's middle in half-widths.
    """

    name = "lens_distortion"
    uses_velocity = False
    order = 1  # it bends what a camera sees from where it stands
    corrected_by_calibration = True
    parameters = (
        Parameter(
            "radial",
            "1",
            "outward shift at the image's left and right edge, as a share",
            -0.2,
            0.2,
            0.0,
        ),
    )
    reference = "Brown, Close-range camera calibration (1971): first radial term"
    invariants = (rotates_about_centre("observe"),)

    @staticmethod
    def describe(values: Values) -> str:
        kind = "pincushion" if values["radial"] > 0 else "barrel"
        share = 100 * abs(values["radial"])
        return (
            f"the lens distorts ({kind}): points at the image's edge are seen "
            f"{share:.1f} % off their distance"
        )

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        radial: Quantity,
    ) -> np.ndarray:
        """Return the points moved outwards by the cube of their distance."""
        offset = points - camera.centre
        half = camera.width / 2 / camera.px_per_m
        observed: np.ndarray = points + radial * offset * np.sum(
            (offset / half) ** 2, axis=-1, keepdims=True
        )
        return observed
