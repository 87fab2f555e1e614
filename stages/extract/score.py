"""Score maps of the string's binary image (IV-B), and lines as binary images."""

from __future__ import annotations

import numpy as np

from stringcast.data.lazy_module import LazyModule

cv2 = LazyModule("cv2")


def pixel_scores(
    mask: np.ndarray, dilations: int, step_px: int
) -> tuple[int, int, np.ndarray]:
    """Score the pixels around the string by repeated dilation (IV-B).

    Each dilation grows the string by a square of 2 step_px + 1, and new pixels score
    one less. So the score falls with the chessboard distance, which is computed
    directly.

    Parameters
    ----------
    mask : (height, width) uint8 array
        Binary image of the string.
    dilations : int
        Score of the string itself, p_max.
    step_px : int
        Growth of one dilation [px].

    Returns
    -------
    row, column : int
        First pixel of the region with scores above 0.
    scores : (rows, columns) uint8 array
        Scores of that region; they are 0 elsewhere.
    """
    left, top, width, height = cv2.boundingRect(mask)
    if not width:
        return 0, 0, np.zeros((0, 0), np.uint8)
    reach = dilations * step_px
    row = max(top - reach, 0)
    column = max(left - reach, 0)
    part = mask[row : top + height + reach, column : left + width + reach]
    distance = cv2.distanceTransform((part == 0).astype(np.uint8), cv2.DIST_C, 3)
    steps = np.ceil(distance / step_px - 1e-6)
    return row, column, np.maximum(dilations - steps, 0).astype(np.uint8)


def rasterise(
    points_px: np.ndarray, shape: tuple[int, ...], width_px: float
) -> np.ndarray:
    """Draw polylines (..., K, 2) of pixels (u, v) as a binary image, uint8 0 or 255."""
    canvas = np.zeros(shape, np.uint8)
    # OpenCV uses fixed-point numbers with 4 fractional bits.
    pixels = np.rint(points_px * 16).astype(np.int32)
    lines = list(pixels.reshape(-1, pixels.shape[-2], 1, 2))
    thickness = max(round(width_px), 1)
    cv2.polylines(canvas, lines, False, 255, thickness, cv2.LINE_8, 4)
    return canvas
