"""The camera's geometry: from the plane of motion [m] to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.lens import Lens

transform = LazyModule("scipy.spatial.transform")

# A camera's y is down, and it looks at the plane from the front.
CAMERA_AXES = np.diag([1.0, -1.0, -1.0])
UNDISTORTION_ITERATIONS = 30  # of a fixed point, which converges for |k1| r^2 < 1/3


@dataclass(frozen=True)
class Camera:
    """A camera that looks at the plane of motion, at right angles except for `tilt`.

    Parameters
    ----------
    width, height : int
        Image size [px].
    px_per_m : float
        Scale of the picture without distortion; with a lens, where its axis meets the
        plane.
    origin_px : (float, float)
        Pixel (u, v) of the world origin in the picture without distortion; u is to the
        right, v is down.
    fps : float
        Frames per second.
    exposure : float
        Shutter time [s].
    distortion : float
        Radial coefficient k1 of r' = r (1 + k1 r^2), r from the image centre in
        half-widths.
    rotation : float
        Counter-clockwise rotation of the world in the picture [rad].
    tilt : (float, float)
        Tilt of the plane about the camera's x and y [rad].
    lens : Lens, optional
        Calibrated lens, instead of `distortion`.

    Raises
    ------
    ValueError
        If distortion and lens are both given, or a tilt without a lens.
    """

    width: Annotated[int, Field(ge=16)]
    height: Annotated[int, Field(ge=16)]
    px_per_m: PositiveFloat
    origin_px: tuple[float, float]
    fps: Annotated[float, Field(gt=0, le=1e5)]
    exposure: NonNegativeFloat = 0.0
    distortion: float = 0.0
    rotation: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    lens: Lens | None = None

    def __post_init__(self) -> None:
        """Refuse contradictory or incomplete settings."""
        if self.lens is not None and self.distortion != 0.0:
            raise ValueError(
                "a lens has its own distortion: set camera.distortion to 0"
            )
        if self.lens is None and any(self.tilt):
            raise ValueError(
                "a tilt is seen by perspective, which needs camera.lens: calibrate, or "
                "set it to 0"
            )

    @property
    def centre(self) -> np.ndarray:
        """World point at the middle of the image, (2,) [m]."""
        return self.world(self._image_centre_and_half_width()[0])

    def pixels(self, world: np.ndarray) -> np.ndarray:
        """Map world points to pixels (u, v).

        Parameters
        ----------
        world : ndarray of shape (..., 2)
            Points in the plane [m].

        Returns
        -------
        ndarray of shape (..., 2)
            Pixels [px], pixel centres at integers.
        """
        if self.lens is not None:
            rays = _map_through_plane(self._plane_to_rays, world)
            return self.lens.pixels(rays[..., :2] / rays[..., 2:])
        flat = np.asarray(self.origin_px) + np.asarray(world) @ self._similarity.T
        if self.distortion == 0.0:
            return flat
        centre, half = self._image_centre_and_half_width()
        offset = (flat - centre) / half
        return centre + half * offset * self._radial_factor(offset)

    def world(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels (u, v) to world points; the inverse of `pixels`.

        Parameters
        ----------
        pixels : ndarray of shape (..., 2)
            Pixels [px], pixel centres at integers.

        Returns
        -------
        ndarray of shape (..., 2)
            Points in the plane [m].
        """
        flat = np.asarray(pixels, dtype=float)
        if self.lens is not None:
            rays_to_plane = np.linalg.inv(self._plane_to_rays)
            points = _map_through_plane(rays_to_plane, self.lens.rays(flat))
            return points[..., :2] / points[..., 2:]
        if self.distortion != 0.0:
            centre, half = self._image_centre_and_half_width()
            bent = (flat - centre) / half
            straight = bent
            for _ in range(UNDISTORTION_ITERATIONS):
                straight = bent / self._radial_factor(straight)
            flat = centre + half * straight
        offset = flat - np.asarray(self.origin_px)
        return offset @ np.linalg.inv(self._similarity).T

    def _radial_factor(self, offset: np.ndarray) -> np.ndarray:
        r2 = np.sum(offset**2, axis=-1, keepdims=True)
        return 1 + self.distortion * r2

    @cached_property
    def _similarity(self) -> np.ndarray:
        """Map from metres to pixels without a lens, (2, 2)."""
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        return self.px_per_m * np.array([[c, -s], [-s, -c]])

    @cached_property
    def _plane_to_rays(self) -> np.ndarray:
        """Map from world points (x, y, 1) to directions before the lens, (3, 3) [m].

        The axis meets the plane at the distance focal / px_per_m, and the origin lies
        in the direction of origin_px.
        """
        assert self.lens is not None
        angles = [*self.tilt, -self.rotation]
        rotation = transform.Rotation.from_euler("XYZ", angles).as_matrix()
        axes = rotation @ CAMERA_AXES
        normal = axes[:, 2]
        to_origin = np.linalg.solve(self.lens.matrix, [*self.origin_px, 1.0])
        distance = self.lens.mean_focal / self.px_per_m
        depth = distance * normal[2] / (normal @ to_origin)
        return np.column_stack([axes[:, :2], depth * to_origin])

    def _image_centre_and_half_width(self) -> tuple[np.ndarray, float]:
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2]), self.width / 2


def _map_through_plane(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map points (..., 2) to (..., 3) by a (3, 3) projection matrix."""
    return np.asarray(points) @ plane[:, :2].T + plane[:, 2]
