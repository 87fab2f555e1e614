"""The part of the picture that the string can reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Window:
    """A part of a picture.

    Parameters
    ----------
    corner : (2,) first pixel (u, v)
    size : (2,) width and height [px]; not positive outside the picture
    """

    corner: np.ndarray
    size: np.ndarray

    def cut(self, image: np.ndarray) -> np.ndarray:
        """Cut the window out of an image (height, width, ...)."""
        left, top = self.corner
        right, bottom = self.corner + self.size
        return image[top:bottom, left:right]

    def paste(self, part: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """Make an image of this shape that is 0 except for `part` in the window."""
        image = np.zeros(shape, part.dtype)
        self.cut(image)[:] = part
        return image


def window_around(centre: np.ndarray, reach: float, shape: tuple[int, ...]) -> Window:
    """Build the window of half width `reach` [px] around a pixel (u, v).

    It is cut off at the edges of a picture of the given shape.
    """
    first = np.maximum(np.floor(centre - reach), 0).astype(int)
    end = np.minimum(np.ceil(centre + reach) + 1, shape[1::-1]).astype(int)
    return Window(first, end - first)
