"""Boxes in the plane: the target, obstacles, and who touches them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

FiniteFloat = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class Box:
    """An upright rectangle: centre (x, y), full width w and height h [m]."""

    x: FiniteFloat
    y: FiniteFloat
    w: Annotated[FiniteFloat, Field(gt=0)]
    h: Annotated[FiniteFloat, Field(gt=0)]

    def is_crossed_by(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether segments from a to b, (..., 2) each [m], touch the box; (...) bool
        (slab method).
        """
        x = _slab_crossing(self.x, self.w / 2, a[..., 0], b[..., 0])
        y = _slab_crossing(self.y, self.h / 2, a[..., 1], b[..., 1])
        return np.maximum(np.maximum(x[0], y[0]), 0.0) <= np.minimum(
            np.minimum(x[1], y[1]), 1.0
        )

    def distance_to_centre(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (..., 2) [m] from the box's centre."""
        return np.hypot(points[..., 0] - self.x, points[..., 1] - self.y)

    def distance_to(self, x: float, y: float) -> float:
        """Distance of a point from the box itself, 0 inside [m]."""
        return float(
            np.hypot(
                max(abs(x - self.x) - self.w / 2, 0),
                max(abs(y - self.y) - self.h / 2, 0),
            )
        )


def _slab_crossing(
    centre: float, half: float, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the ways from coordinates a to b at which they enter and leave a slab,
    +inf and -inf for never.
    """
    way = b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (centre - half - a) / way, (centre + half - a) / way
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    still = way == 0
    if still.any():
        outside = np.abs(a - centre) > half
        enter = np.where(still, np.where(outside, np.inf, -np.inf), enter)
        leave = np.where(still, np.where(outside, -np.inf, np.inf), leave)
    return enter, leave
