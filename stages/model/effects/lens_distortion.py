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
    """Radial distortion r' = r (1 + k r^2) that the camera does not correct.

    r is the distance from the image centre in half-widths.
    """

    name = "lens_distortion"
    uses_velocity = False
    order = 1  # distortion follows the camera's pose
    corrected_by_calibration = True
    parameters = (
        Parameter(
            "radial",
            "1",
            "relative outward shift at the image's left and right edge",
            -0.2,
            0.2,
            0.0,
        ),
    )
    reference = "Brown, Close-range camera calibration (1971): first radial term"
    invariants = (rotates_about_centre("observe"),)

    @staticmethod
    def describe(values: Values) -> str:
        is_outward = values["radial"] > 0
        kind = "pincushion" if is_outward else "barrel"
        place = "far from" if is_outward else "near to"
        share = 100 * abs(values["radial"])
        return (
            f"the lens distorts ({kind}): points at the image's edge are seen "
            f"{share:.1f} % too {place} its centre"
        )

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        radial: Quantity,
    ) -> np.ndarray:
        """Return the distorted points."""
        offset = points - camera.centre
        half = camera.width / 2 / camera.px_per_m
        return points + radial * offset * np.sum(
            (offset / half) ** 2, axis=-1, keepdims=True
        )
