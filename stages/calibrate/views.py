"""Detection of the board in pictures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stringcast.data.images import to_grey
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.calibrate.board import Board
from stringcast.stages.common import rms

cv2 = LazyModule("cv2")

MIN_CORNERS = 8  # twice the minimum for a pose
CORNER_TOLERANCE_PX = 1e-3  # convergence of a corner
MAX_MARKER_MISFIT = 0.25  # RMS from an undistorted board, in marker sides


@dataclass(frozen=True)
class BoardView:
    """The board in one picture.

    Attributes
    ----------
    number
        Number of the picture.
    image
        The grey picture, uint8.
    corners, pixels
        Numbers of the corners (N,) and their pixels (N, 2).
    reason
        Why the picture cannot be used; empty if it can.
    """

    number: int
    image: np.ndarray = field(repr=False)
    corners: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    pixels: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    reason: str = ""


def detect_board(number: int, image: np.ndarray, board: Board) -> BoardView:
    """Find the board's corners in a picture.

    Parameters
    ----------
    number
        Number of the picture.
    image
        The picture (height, width) or (height, width, 3), uint8.
    board
        The board.

    Returns
    -------
    BoardView
        The corners, or the reason why they cannot be used.
    """
    grey = to_grey(image)
    parameters = cv2.aruco.DetectorParameters()
    # OpenCV's default stops a tenth of a pixel from the corner.
    parameters.cornerRefinementMinAccuracy = CORNER_TOLERANCE_PX
    detector = cv2.aruco.CharucoDetector(
        board.pattern, cv2.aruco.CharucoParameters(), parameters
    )
    pixels, corners, markers, ids = detector.detectBoard(grey)
    if ids is None or not len(ids):
        return BoardView(number, grey, reason="no marker of the dictionary is seen")
    numbers = np.zeros(0, int) if corners is None else corners.ravel()
    marker_pixels = np.array(markers).reshape(-1, 4, 2)
    reason = _board_mismatch(board, marker_pixels, ids.ravel())
    if not reason:
        reason = _corner_fault(board, numbers)
    if reason:
        return BoardView(number, grey, reason=reason)
    return BoardView(number, grey, numbers, pixels.reshape(-1, 2).astype(float))


def _corner_fault(board: Board, numbers: np.ndarray) -> str:
    """Return why corners do not determine the board's pose; empty if they do."""
    count = len(numbers)
    if count < MIN_CORNERS:
        return f"{count} corners are seen, {MIN_CORNERS} are needed"
    # Four corners, no three of them on a line, determine the pose.
    for line in np.divmod(numbers, board.squares[0] - 1):  # rows, columns
        if count - np.bincount(line).max() < 2:
            return f"the {count} corners that are seen are on one line"
    return ""


def _board_mismatch(board: Board, markers: np.ndarray, ids: np.ndarray) -> str:
    """Return why markers (M, 4, 2) [px] are of another board, or an empty string."""
    if ids.max() >= board.markers:
        return (
            f"marker {ids.max()} is seen, the board of the settings has 0 to "
            f"{board.markers - 1}: it is another board"
        )
    if len(ids) < 3:
        return ""
    expected, seen = board.marker_corners[ids].reshape(-1, 2), markers.reshape(-1, 2)
    to_picture, _ = cv2.findHomography(expected, seen)
    error = cv2.perspectiveTransform(expected[None], to_picture)[0] - seen
    side = np.median(np.linalg.norm(markers[:, 0] - markers[:, 1], axis=-1))
    if rms(error) > MAX_MARKER_MISFIT * side:
        return (
            "its markers are not where the board of the settings has them: it is "
            "another board"
        )
    return ""
