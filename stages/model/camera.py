"""The camera's geometry: from the plane of motion [m] to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field


@dataclass(frozen=True)
class Camera:
    """A camera that looks squarely at the plane of motion.

    width, height: image size [px]. px_per_m: scale. origin_px: pixel (u, v) of the world
    origin; u is to the right, v is down. fps: frames per second. exposure: shutter time [s].
    distortion: radial coefficient k1 of r' = r (1 + k1 r^2), r from the image centre in
    half-widths.
    """

    width: Annotated[int, Field(ge=16)]
    height: Annotated[int, Field(ge=16)]
    px_per_m: Annotated[float, Field(gt=0)]
    origin_px: tuple[float, float]
    fps: Annotated[float, Field(gt=0)]
    exposure: Annotated[float, Field(ge=0)] = 0.0
    distortion: float = 0.0

    @property
    def centre(self) -> np.ndarray:
        """World point at the middle of the image, (2,) [m]."""
        return self.world(self._frame()[0])

    def pixels(self, world: np.ndarray) -> np.ndarray:
        """Pixels (u, v) of world points. world: (..., 2) [m]. Returns (..., 2) [px], pixel centres at integers."""
        flat = np.asarray(self.origin_px) + np.asarray(world) * np.array([self.px_per_m, -self.px_per_m])
        if self.distortion == 0.0:
            return flat
        centre, half = self._frame()
        offset = (flat - centre) / half
        return centre + half * offset * (1 + self.distortion * np.sum(offset**2, axis=-1, keepdims=True))

    def world(self, pixels: np.ndarray) -> np.ndarray:
        """World points [m] of pixels (u, v); the inverse of `pixels`. pixels: (..., 2). Returns (..., 2)."""
        flat = np.asarray(pixels, dtype=float)
        if self.distortion != 0.0:
            flat = self._straighten(flat)
        return (flat - np.asarray(self.origin_px)) / np.array([self.px_per_m, -self.px_per_m])

    def _frame(self) -> tuple[np.ndarray, float]:
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2]), self.width / 2

    def _straighten(self, pixels: np.ndarray) -> np.ndarray:
        """Undo the distortion by fixed-point iteration (converges for |k1| r^2 < 1/3)."""
        centre, half = self._frame()
        bent = (pixels - centre) / half
        straight = bent
        for _ in range(30):
            straight = bent / (1 + self.distortion * np.sum(straight**2, axis=-1, keepdims=True))
        return centre + half * straight
