"""The ChArUco board: a chessboard with markers that identify every corner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PositiveFloat

from stringcast.data.lazy_module import LazyModule

cv2 = LazyModule("cv2")


@dataclass(frozen=True)
class Board:
    """A board with a marker in each white square.

    Attributes
    ----------
    squares
        Columns and rows.
    square, marker
        Sides of squares and markers [m].
    dictionary
        OpenCV's name of the marker dictionary.

    References
    ----------
    Garrido-Jurado et al., "Automatic generation and detection of highly reliable
    fiducial markers", 2014.
    """

    squares: tuple[Annotated[int, Field(ge=3)], Annotated[int, Field(ge=3)]]
    square: PositiveFloat
    marker: PositiveFloat
    dictionary: str

    def __post_init__(self) -> None:
        """Refuse an impossible board."""
        if self.marker >= self.square:
            raise ValueError("a marker must be smaller than the square that it lies in")
        if not hasattr(cv2.aruco, self.dictionary):
            raise ValueError(
                f"OpenCV has no dictionary {self.dictionary}; DICT_5X5_100 is one"
            )
        if self.markers > self.dictionary_size:
            raise ValueError(
                f"{self.dictionary} has {self.dictionary_size} markers, the board "
                f"needs {self.markers}"
            )

    @property
    def markers(self) -> int:
        """Number of markers on the board."""
        return self.squares[0] * self.squares[1] // 2

    @property
    def dictionary_size(self) -> int:
        """Number of markers in the dictionary."""
        return len(self._markers.bytesList)

    @property
    def _markers(self) -> Any:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def size(self) -> np.ndarray:
        """Width and height of the pattern, (2,) [m]."""
        return np.array(self.squares) * self.square

    @property
    def pattern(self) -> Any:
        """OpenCV's object for the pattern."""
        return cv2.aruco.CharucoBoard(
            self.squares, self.square, self.marker, self._markers
        )

    @property
    def corners(self) -> np.ndarray:
        """Inner corners (N, 2) [m], x right and y up from the lower left corner."""
        upper_left = np.array([0.0, self.size[1]])
        return upper_left + self.points[:, :2] * np.array([1.0, -1.0])

    @property
    def points(self) -> np.ndarray:
        """Inner corners (N, 3) [m] in OpenCV's axes.

        y points down from the upper left corner of the pattern, z into it.
        """
        return np.array(self.pattern.getChessboardCorners(), dtype=float)

    @property
    def marker_corners(self) -> np.ndarray:
        """Corners of each marker (M, 4, 2) [m], in the axes of `points`."""
        return np.array(self.pattern.getObjPoints(), dtype=float)[..., :2]

    def image(self, px_per_square: int) -> np.ndarray:
        """Draw the pattern without a border, uint8."""
        size = (self.squares[0] * px_per_square, self.squares[1] * px_per_square)
        return self.pattern.generateImage(size)
