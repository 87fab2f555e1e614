"""Score maps (IV-B): the binary image dilated again and again, each time scoring one
less.
"""

from __future__ import annotations

import cv2
import numpy as np


def pixel_scores(
    mask: np.ndarray, dilations: int, step_px: int
) -> tuple[int, int, np.ndarray]:
    """Scores p of the pixels about the string, (height, width) uint8, behind the first
    row and column of that part: `dilations` (p_max) on the string, down to 0, as all is
    beyond.

    Each dilation grows the string by `step_px` in the eight directions (a square
    element of 2 step_px + 1), so that the score falls with the chessboard distance.
    """
    left, top, width, height = cv2.boundingRect(mask)
    if not width:
        return 0, 0, np.zeros((0, 0), np.uint8)
    reach = dilations * step_px
    first, begin = max(top - reach, 0), max(left - reach, 0)
    around = mask[first : top + height + reach, begin : left + width + reach]
    distance = cv2.distanceTransform((around == 0).astype(np.uint8), cv2.DIST_C, 3)
    steps = np.ceil(distance / step_px - 1e-6)
    return first, begin, np.maximum(dilations - steps, 0).astype(np.uint8)


def rasterise(
    points_px: np.ndarray, shape: tuple[int, int], width_px: float
) -> np.ndarray:
    """A binary image of a polyline, uint8 0 or 255. points_px: (K, 2) as (u, v)."""
    canvas = np.zeros(shape, np.uint8)
    pixels = np.rint(points_px * 16).astype(np.int32)
    cv2.polylines(
        canvas, [pixels[:, None]], False, 255, max(round(width_px), 1), cv2.LINE_8, 4
    )
    return canvas
