"""Boxes in the plane, such as targets and obstacles."""

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

    @property
    def centre(self) -> np.ndarray:
        """Centre of the box, (2,) [m]."""
        return np.array([self.x, self.y])

    @property
    def half_size(self) -> np.ndarray:
        """Half the width and half the height, (2,) [m]."""
        return np.array([self.w, self.h]) / 2

    def is_crossed_by(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return whether segments touch the box, (...) bool, by the slab method.

        a, b: ends of the segments, (..., 2) [m].
        """
        enter, leave = _slab_crossing(self.centre, self.half_size, a, b)
        first = np.maximum(enter[..., 0], enter[..., 1])
        last = np.minimum(leave[..., 0], leave[..., 1])
        return np.maximum(first, 0.0) <= np.minimum(last, 1.0)

    def is_crossed_along(self, path: np.ndarray) -> np.ndarray:
        """Return whether segments of paths (..., K, 2) touch the box, (..., K - 1)."""
        return self.is_crossed_by(path[..., :-1, :], path[..., 1:, :])

    def distance_to_centre(self, points: np.ndarray) -> np.ndarray:
        """Return the distance of points (..., 2) [m] from the box's centre."""
        return np.hypot(points[..., 0] - self.x, points[..., 1] - self.y)

    def distance_to(self, x: float, y: float) -> float:
        """Return the distance of a point from the box [m]; 0 inside."""
        offset = np.abs(np.array([x, y]) - self.centre)
        beyond = np.maximum(offset - self.half_size, 0)
        return float(np.hypot(*beyond))


def _slab_crossing(
    centre: np.ndarray, half: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the fractions of the lines from a to b at which they enter and leave slabs.

    There is one slab for each coordinate. a, b: (..., 2) [m]. A line that misses a slab
    enters at +inf and leaves at -inf.
    """
    displacement = b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (centre - half - a) / displacement
        second = (centre + half - a) / displacement
    enter = np.minimum(first, second)
    leave = np.maximum(first, second)
    is_parallel = displacement == 0
    if is_parallel.any():
        outside = np.where(np.abs(a - centre) > half, np.inf, -np.inf)
        enter = np.where(is_parallel, outside, enter)
        leave = np.where(is_parallel, -outside, leave)
    return enter, leave
