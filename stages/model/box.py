"""Boxes in the plane: the target, obstacles, and who touches them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field


@dataclass(frozen=True)
class Box:
    """An upright rectangle: centre (x, y), full width w and height h [m]."""

    x: float
    y: float
    w: Annotated[float, Field(gt=0)]
    h: Annotated[float, Field(gt=0)]

    def crossed(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether segments from a to b, (..., 2) each [m], touch the box; (...) bool (slab method)."""
        centre, half = np.array([self.x, self.y]), np.array([self.w, self.h]) / 2
        way = b - a
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (centre - half - a) / way, (centre + half - a) / way
        outside = np.abs(a - centre) > half
        still = way == 0
        enter = np.where(still, np.where(outside, np.inf, -np.inf), np.minimum(first, second))
        leave = np.where(still, np.where(outside, -np.inf, np.inf), np.maximum(first, second))
        return np.maximum(enter.max(axis=-1), 0.0) <= np.minimum(leave.min(axis=-1), 1.0)

    def away(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (..., 2) [m] from the box's centre."""
        return np.hypot(points[..., 0] - self.x, points[..., 1] - self.y)

    def gap(self, x: float, y: float) -> float:
        """Distance of a point from the box itself, 0 inside [m]."""
        return float(np.hypot(max(abs(x - self.x) - self.w / 2, 0), max(abs(y - self.y) - self.h / 2, 0)))
