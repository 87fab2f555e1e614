"""Sequences of images that are read one by one, from image files or from a video."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from data.schema import DataError

ROOM = 1 << 29  # [bytes] of images that are held at a time
PACKING = (
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB),
)


class Images(Sequence[np.ndarray]):
    """Grey images, uint8 (height, width); an index reads one, a slice a list of them."""

    @abstractmethod
    def read(self, index: int) -> np.ndarray:
        """The image at 0 <= index < len; raises DataError where it is missing or damaged."""

    def __getitem__(self, index: Any) -> Any:
        """One image, or a list of them for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        return self.read(int(index) % len(self))


@dataclass(frozen=True)
class ImageFiles(Images):
    """Image files, their paths relative to `folder`."""

    folder: Path
    files: tuple[str, ...]

    def __len__(self) -> int:
        """Number of images."""
        return len(self.files)

    def read(self, index: int) -> np.ndarray:
        """One image."""
        path = self.folder / self.files[index]
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise DataError(f"{path}: the frame is missing or damaged. Restore it or leave its trial out.")
        return image


@dataclass(frozen=True)
class Video(Images):
    """The frames of a video file; quick when read in order."""

    path: Path

    @cached_property
    def _capture(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise DataError(f"{self.path}: not a video that OpenCV can read. Convert it, or store frames as PNG.")
        return capture

    @property
    def fps(self) -> float:
        """Frames per second, as the file says; of slow motion that may be the speed of playing [1/s]."""
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    def __len__(self) -> int:
        """Number of frames, as the file says."""
        return int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))

    def read(self, index: int) -> np.ndarray:
        """One frame."""
        if int(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) != index:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
        good, image = self._capture.read()
        if not good:
            raise DataError(f"{self.path}: frame {index} cannot be read. Restore the file or leave its trial out.")
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


class Held(Images):
    """Images that are read or unpacked once where they are looked at often: as many as `ROOM` holds, the latest."""

    def __init__(self, images: Sequence[np.ndarray]) -> None:
        """images: uint8 arrays (height, width), at least one."""
        self._count = len(images)
        self._held = lru_cache(max(ROOM // images[0].nbytes, 1))(images.__getitem__)

    def __len__(self) -> int:
        """Number of images."""
        return self._count

    def read(self, index: int) -> np.ndarray:
        """One image, not to be written to."""
        return self._held(index)


def png(image: np.ndarray) -> bytes:
    """An image as PNG, without loss, packed fast rather than small: of a sensor's noise nothing repeats."""
    good, content = cv2.imencode(".png", image, PACKING)
    assert good, f"an image of shape {image.shape} and type {image.dtype} cannot be a PNG"
    return content.tobytes()
