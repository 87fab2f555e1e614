"""Detection of the board in pictures."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from stringcast.stages.calibrate.board import Board

MIN_CORNERS = 8  # corners that fix a board's place with something to spare
CORNER_TOLERANCE = 1e-3  # [px] of a step towards a corner that is small enough
# marker sides by which markers may be off a board seen without distortion
MAX_MARKER_MISFIT = 0.25


@dataclass(frozen=True)
class BoardView:
    """One picture. number: among those given. corners: (N,) names, and pixels (N, 2)
    where they are. reason: why it cannot be used; empty if it can.
    """

    number: int
    image: np.ndarray = field(repr=False)
    corners: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    pixels: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    reason: str = ""


def detect_board(number: int, image: np.ndarray, board: Board) -> BoardView:
    """Find the board's corners in a picture (height, width) or (height, width, 3)
    uint8; with the reason where they cannot be used.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    how = cv2.aruco.DetectorParameters()
    # by itself, OpenCV stops a tenth of a pixel from the corner
    how.cornerRefinementMinAccuracy = CORNER_TOLERANCE
    detector = cv2.aruco.CharucoDetector(
        board.pattern, cv2.aruco.CharucoParameters(), how
    )
    pixels, corners, at, ids = detector.detectBoard(grey)
    if ids is None or not len(ids):
        return BoardView(number, grey, reason="no marker of the dictionary is seen")
    names = np.zeros(0, int) if corners is None else corners.ravel()
    reason = _board_mismatch(board, np.array(at).reshape(-1, 4, 2), ids.ravel())
    if not reason and len(names) < MIN_CORNERS:
        reason = f"{len(names)} corners are seen, {MIN_CORNERS} are needed"
    # four corners fix its place, no three of them on a line
    lines = np.divmod(names, board.squares[0] - 1)
    if not reason and min(len(names) - np.bincount(line).max() for line in lines) < 2:
        reason = f"the {len(names)} corners that are seen are on one line"
    if reason:
        return BoardView(number, grey, reason=reason)
    return BoardView(number, grey, names, pixels.reshape(-1, 2).astype(float))


def _board_mismatch(board: Board, at: np.ndarray, ids: np.ndarray) -> str:
    """Why it must be another board; empty if it need not be. at: corners (M, 4, 2) of
    the markers seen [px].
    """
    if ids.max() >= board.markers:
        there = f"the board of the settings has 0 to {board.markers - 1}"
        return f"marker {ids.max()} is seen, {there}: it is another board"
    if len(ids) < 3:
        return ""
    flat, seen = board.marker_corners[ids].reshape(-1, 2), at.reshape(-1, 2)
    to_picture, _ = cv2.findHomography(flat, seen)
    off = cv2.perspectiveTransform(flat[None], to_picture)[0] - seen
    side = np.median(np.linalg.norm(at[:, 0] - at[:, 1], axis=-1))
    if np.sqrt(np.mean(off**2)) > MAX_MARKER_MISFIT * side:
        return "its markers are not where the board of the settings has them: it is another board"
    return ""
