"""The ChArUco board: a chessboard with a marker in each white square, so that every
corner has a name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field


@dataclass(frozen=True)
class Board:
    """squares: columns and rows. square, marker: their sides [m]. dictionary: of the
    markers, by OpenCV's name.

    Garrido-Jurado et al., Automatic generation and detection of highly reliable
    fiducial markers (2014).
    """

    squares: tuple[Annotated[int, Field(ge=3)], Annotated[int, Field(ge=3)]]
    square: Annotated[float, Field(gt=0)]
    marker: Annotated[float, Field(gt=0)]
    dictionary: str

    def __post_init__(self) -> None:
        """Refuse a board that cannot be."""
        if self.marker >= self.square:
            raise ValueError("a marker must be smaller than the square that it lies in")
        if not hasattr(cv2.aruco, self.dictionary):
            raise ValueError(
                f"OpenCV has no dictionary {self.dictionary}; DICT_5X5_100 is one"
            )
        if self.markers > self.dictionary_size:
            raise ValueError(
                f"{self.dictionary} has {self.dictionary_size} markers, the board needs {self.markers}"
            )

    @property
    def markers(self) -> int:
        """The number of markers on the board."""
        return self.squares[0] * self.squares[1] // 2

    @property
    def dictionary_size(self) -> int:
        """The number of markers in the dictionary."""
        return len(
            cv2.aruco.getPredefinedDictionary(
                getattr(cv2.aruco, self.dictionary)
            ).bytesList
        )

    @property
    def size(self) -> np.ndarray:
        """Width and height of the pattern, (2,) [m]."""
        return np.array(self.squares) * self.square

    @property
    def pattern(self) -> cv2.aruco.CharucoBoard:
        """The pattern as OpenCV's class."""
        dictionary = cv2.aruco.getPredefinedDictionary(
            getattr(cv2.aruco, self.dictionary)
        )
        return cv2.aruco.CharucoBoard(
            self.squares, self.square, self.marker, dictionary
        )

    @property
    def corners(self) -> np.ndarray:
        """(N, 2) inner corners [m]: x to the right, y up, from the lower left corner of
        the printed pattern.
        """
        return np.array([0.0, self.size[1]]) + self.points[:, :2] * np.array(
            [1.0, -1.0]
        )

    @property
    def points(self) -> np.ndarray:
        """(N, 3) inner corners [m] as OpenCV has them: y down, from the upper left
        corner of the pattern, z into it.
        """
        return np.array(self.pattern.getChessboardCorners(), dtype=float)

    @property
    def marker_corners(self) -> np.ndarray:
        """(M, 4, 2) corners of each marker [m], x and y as of `points`."""
        return np.array(self.pattern.getObjPoints(), dtype=float)[..., :2]

    def image(self, px_per_square: int) -> np.ndarray:
        """The pattern without a border, uint8."""
        size = (self.squares[0] * px_per_square, self.squares[1] * px_per_square)
        return np.asarray(self.pattern.generateImage(size))
