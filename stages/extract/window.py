"""The part of the picture that the string can reach from where it is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Window:
    """Rows and columns of a picture, each from first to before last [px]."""

    rows: tuple[int, int]
    columns: tuple[int, int]

    @property
    def corner(self) -> np.ndarray:
        """(u, v) of its first pixel."""
        return np.array([self.columns[0], self.rows[0]], dtype=float)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width); nothing where it lies outside the picture."""
        return max(self.rows[1] - self.rows[0], 0), max(
            self.columns[1] - self.columns[0], 0
        )

    def cut(self, image: np.ndarray) -> np.ndarray:
        """The part of an image (height, width, ...) in the window."""
        return image[slice(*self.rows), slice(*self.columns)]

    def paste(self, part: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """An image of a shape that is 0 but for the window, which holds `part`."""
        whole = np.zeros(shape, part.dtype)
        self.cut(whole)[:] = part
        return whole


def window_around(centre: np.ndarray, reach: float, shape: tuple[int, ...]) -> Window:
    """The window of half width `reach` [px] about a place (u, v), cut at the picture's
    edges.
    """
    low = np.maximum(np.floor(centre - reach), 0).astype(int)
    high = np.minimum(np.ceil(centre + reach) + 1, shape[1::-1]).astype(int)
    return Window((int(low[1]), int(high[1])), (int(low[0]), int(high[0])))
