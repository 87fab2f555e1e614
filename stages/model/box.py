"""Boxes in the plane: the target, obstacles, and who touches them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

FiniteFloat = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class Box:
    """A rectangle with sides along x and y, such as a target or an obstacle.

    Parameters
    ----------
    x, y : float
        Centre [m].
    w, h : float
        Full width and height [m].
    """

    x: FiniteFloat
    y: FiniteFloat
    w: Annotated[FiniteFloat, Field(gt=0)]
    h: Annotated[FiniteFloat, Field(gt=0)]

    def is_crossed_by(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return whether segments touch the box, (...) bool, by the slab method.

        a, b: ends of the segments, (..., 2) [m].
        """
        enter_x, leave_x = _slab_crossing(self.x, self.w / 2, a[..., 0], b[..., 0])
        enter_y, leave_y = _slab_crossing(self.y, self.h / 2, a[..., 1], b[..., 1])
        enter = np.maximum(np.maximum(enter_x, enter_y), 0.0)
        leave = np.minimum(np.minimum(leave_x, leave_y), 1.0)
        crosses: np.ndarray = enter <= leave
        return crosses

    def distance_to_centre(self, points: np.ndarray) -> np.ndarray:
        """Return the distance of points (..., 2) [m] from the box's centre."""
        return np.hypot(points[..., 0] - self.x, points[..., 1] - self.y)

    def distance_to(self, x: float, y: float) -> float:
        """Return the distance of a point from the box itself, 0 inside [m]."""
        across = max(abs(x - self.x) - self.w / 2, 0)
        up = max(abs(y - self.y) - self.h / 2, 0)
        return float(np.hypot(across, up))


def _slab_crossing(
    centre: float, half: float, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the shares of the ways from a to b at which they enter and leave a slab.

    a, b: coordinates [m]. +inf and -inf for never.
    """
    way = b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (centre - half - a) / way
        second = (centre + half - a) / way
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    still = way == 0
    if still.any():
        outside = np.where(np.abs(a - centre) > half, np.inf, -np.inf)
        enter = np.where(still, outside, enter)
        leave = np.where(still, -outside, leave)
    return enter, leave
