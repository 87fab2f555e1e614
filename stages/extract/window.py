"""The part of the picture that the string can reach from where it is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Window:
    """Rows and columns of a picture: first and one past the last pixel of each."""

    rows: tuple[int, int]
    columns: tuple[int, int]

    @property
    def corner(self) -> np.ndarray:
        """Pixel (u, v) at which the window begins, (2,)."""
        return np.array([self.columns[0], self.rows[0]], dtype=float)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px]; zero where the window lies outside the picture."""
        height = self.rows[1] - self.rows[0]
        width = self.columns[1] - self.columns[0]
        return max(height, 0), max(width, 0)

    def cut(self, image: np.ndarray) -> np.ndarray:
        """Cut the window out of an image (height, width, ...)."""
        return image[slice(*self.rows), slice(*self.columns)]

    def paste(self, part: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Make an image of this shape that is 0 except for `part` in the window."""
        image = np.zeros(shape, part.dtype)
        self.cut(image)[:] = part
        return image


def window_around(centre: np.ndarray, reach: float, shape: tuple[int, ...]) -> Window:
    """Build the window of half width `reach` [px] around a pixel (u, v).

    It ends where the picture of the given shape ends.
    """
    low = np.maximum(np.floor(centre - reach), 0).astype(int)
    high = np.minimum(np.ceil(centre + reach) + 1, shape[1::-1]).astype(int)
    return Window((int(low[1]), int(high[1])), (int(low[0]), int(high[0])))
