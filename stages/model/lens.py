"""A lens: maps directions in front of the camera to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.data.lazy_module import LazyModule

cv2 = LazyModule("cv2")

# Termination of the inversion of the distortion.
MAX_STEPS = 100
TOLERANCE = 1e-12


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with Brown's distortion, as in OpenCV.

    Parameters
    ----------
    focal : (float, float)
        Focal lengths fx, fy [px].
    centre : (float, float)
        Principal point cx, cy [px], pixel centres at integers.
    distortion : (float, float, float, float)
        k1, k2, p1, p2 [1]: radial coefficients k of r^2 and r^4, tangential ones p.

    References
    ----------
    Brown, Close-range camera calibration (1971).
    """

    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, float, float, float]

    @property
    def matrix(self) -> np.ndarray:
        """Camera matrix, (3, 3)."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    @property
    def mean_focal(self) -> float:
        """Geometric mean of both focal lengths [px]."""
        fx, fy = self.focal
        return float(np.sqrt(fx * fy))

    def pixels(self, rays: np.ndarray) -> np.ndarray:
        """Map directions (..., 2) to pixels (u, v) (..., 2).

        With directions x and y, r^2 = x^2 + y^2 and d = 1 + k1 r^2 + k2 r^4,

            u = fx (x d + 2 p1 x y + p2 (r^2 + 2 x^2)) + cx
            v = fy (y d + p1 (r^2 + 2 y^2) + 2 p2 x y) + cy.

        rays: x/z and y/z, x right, y down, z forward.
        """
        rays = np.asarray(rays, dtype=float)
        x, y = rays[..., 0], rays[..., 1]
        (fx, fy), (cx, cy) = self.focal, self.centre
        k1, k2, p1, p2 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * k2)
        tangential_x = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        tangential_y = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        u = fx * (x * radial + tangential_x) + cx
        v = fy * (y * radial + tangential_y) + cy
        return np.stack([u, v], axis=-1)

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels (..., 2) to directions (..., 2).

        The inverse of `pixels` where the lens is one to one.
        """
        flat = np.asarray(pixels, dtype=float).reshape(-1, 1, 2)
        if not len(flat):
            return np.zeros(np.shape(pixels))
        kind = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS
        stop = (kind, MAX_STEPS, TOLERANCE)
        distortion = np.array(self.distortion)
        rays = cv2.undistortPoints(
            flat, self.matrix, distortion, None, None, None, stop
        )
        return rays.reshape(np.shape(pixels))
