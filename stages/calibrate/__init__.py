"""Calibrate: from pictures of a printed board, the lens of a camera and where it sees the plane of motion."""

from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.calibrate import calibrate

__all__ = ["Board", "calibrate"]
