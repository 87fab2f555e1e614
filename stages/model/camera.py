"""The camera's geometry: from the plane of motion [m] to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.model.lens import Lens

transform = LazyModule("scipy.spatial.transform")

# a camera's y is down, and it looks at the plane from the front
CAMERA_AXES = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Camera:
    """A camera that looks at the plane of motion, squarely but for `tilt`.

    width, height: image size [px]. px_per_m: scale; with a lens, where its axis meets
    the plane. origin_px: pixel (u, v) of the world origin; u is to the right, v is
    down. fps: frames per second. exposure: shutter time [s]. distortion: radial
    coefficient k1 of r' = r (1 + k1 r^2), r from the image centre in half-widths.
    rotation: by which the world is seen turned, counter-clockwise [rad]. tilt: of the
    plane about the camera's x and y [rad]. lens: as measured by a calibration; it takes
    the place of `distortion`. scale and origin are those of the picture without
    distortion.
    """

    width: Annotated[int, Field(ge=16)]
    height: Annotated[int, Field(ge=16)]
    px_per_m: Annotated[float, Field(gt=0)]
    origin_px: tuple[float, float]
    fps: Annotated[float, Field(gt=0)]
    exposure: Annotated[float, Field(ge=0)] = 0.0
    distortion: float = 0.0
    rotation: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    lens: Lens | None = None

    def __post_init__(self) -> None:
        """Refuse what says two things at once, or half of one."""
        if self.lens is not None and self.distortion != 0.0:
            raise ValueError(
                "a lens has its own distortion: set camera.distortion to 0"
            )
        if self.lens is None and any(self.tilt):
            raise ValueError(
                "a tilt is seen by perspective, which needs camera.lens: calibrate, or set it to 0"
            )

    @property
    def centre(self) -> np.ndarray:
        """World point at the middle of the image, (2,) [m]."""
        return self.world(self._image_centre_and_half_width()[0])

    def pixels(self, world: np.ndarray) -> np.ndarray:
        """Pixels (u, v) of world points. world: (..., 2) [m]. Returns (..., 2) [px],
        pixel centres at integers.
        """
        if self.lens is not None:
            ahead = _map_through_plane(self._plane_to_rays, world)
            return self.lens.pixels(ahead[..., :2] / ahead[..., 2:])
        flat = np.asarray(self.origin_px) + np.asarray(world) @ self._similarity.T
        if self.distortion == 0.0:
            return flat
        centre, half = self._image_centre_and_half_width()
        offset = (flat - centre) / half
        return centre + half * offset * (
            1 + self.distortion * np.sum(offset**2, axis=-1, keepdims=True)
        )

    def world(self, pixels: np.ndarray) -> np.ndarray:
        """World points [m] of pixels (u, v); the inverse of `pixels`. pixels: (..., 2).
        Returns (..., 2).
        """
        flat = np.asarray(pixels, dtype=float)
        if self.lens is not None:
            there = _map_through_plane(
                np.linalg.inv(self._plane_to_rays), self.lens.rays(flat)
            )
            return there[..., :2] / there[..., 2:]
        if self.distortion != 0.0:
            centre, half = self._image_centre_and_half_width()
            bent = (flat - centre) / half
            straight = bent
            # a fixed point, to which this converges for |k1| r^2 < 1/3
            for _ in range(30):
                straight = bent / (
                    1 + self.distortion * np.sum(straight**2, axis=-1, keepdims=True)
                )
            flat = centre + half * straight
        return (flat - np.asarray(self.origin_px)) @ np.linalg.inv(self._similarity).T

    @cached_property
    def _similarity(self) -> np.ndarray:
        """(2, 2), from metres to pixels, without a lens."""
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        return self.px_per_m * np.array([[c, -s], [-s, -c]])

    @cached_property
    def _plane_to_rays(self) -> np.ndarray:
        """(3, 3), from world points (x, y, 1) to directions (x, y, z) [m] in front of
        the lens.

        The axis meets the plane at the distance focal / px_per_m, and the origin lies
        in the direction of origin_px.
        """
        assert self.lens is not None
        turn = (
            transform.Rotation.from_euler(
                "XYZ", [*self.tilt, -self.rotation]
            ).as_matrix()
            @ CAMERA_AXES
        )
        normal, straight = (
            turn[:, 2],
            np.linalg.solve(self.lens.matrix, [*self.origin_px, 1.0]),
        )
        depth = self.lens.mean_focal / self.px_per_m * normal[2] / (normal @ straight)
        return np.column_stack([turn[:, :2], depth * straight])

    def _image_centre_and_half_width(self) -> tuple[np.ndarray, float]:
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2]), self.width / 2


def _map_through_plane(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 2) as (..., 3) through a (3, 3) map of planes."""
    return np.asarray(points) @ plane[:, :2].T + plane[:, 2]
