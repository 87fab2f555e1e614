"""Sequences of images that are read one by one, from image files or from a video, and
those of a dataset.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from stringcast.data.file_checks import MAX_PIXELS, require_inside, require_plain_file
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError

cv2 = LazyModule("cv2")

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv")
# [bytes] of an image file: more than twice the largest sensors' 16-bit colours unpacked
MAX_IMAGE_BYTES = 1 << 28
MAX_VIDEO_FRAMES = 1 << 20  # of a video: a quarter of an hour at 1000 a second
VIDEO_SIGNATURES = (b"RIFF", b"\x1aE\xdf\xa3")  # how AVI and Matroska begin
# how MP4 and QuickTime do, from byte 4
MP4_ATOMS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")
CACHE_BYTES = 1 << 29  # [bytes] of images that are held at a time


class Images(Sequence[np.ndarray]):
    """Grey images, uint8 (height, width); an index reads one, a slice a list of them."""

    @abstractmethod
    def read(self, index: int) -> np.ndarray:
        """The image at 0 <= index < len; raises DataError where it is missing or
        damaged.
        """

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

    @cached_property
    def _first_size(self) -> str:
        return _image_size(self.folder / self.files[0])

    def __len__(self) -> int:
        """Number of images."""
        return len(self.files)

    def read(self, index: int) -> np.ndarray:
        """The image of the file number `index`, uint8 (height, width)."""
        path = self.folder / self.files[index]
        if _image_size(path) != self._first_size:
            raise DataError(
                f"{path}: it has {_image_size(path)} pixels, the first frame of its trial has {self._first_size}. Store all alike."
            )
        # imread opens no name beyond ASCII on Windows
        packed = np.frombuffer(path.read_bytes(), np.uint8)
        image = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise DataError(
                f"{path}: the frame is missing or damaged. Restore it or leave its trial out."
            )
        return image


@dataclass(frozen=True)
class Video(Images):
    """The frames of a video file; quick when read in order."""

    path: Path

    @cached_property
    def _capture(self) -> Any:
        with require_plain_file(self.path).open("rb") as file:
            begins = file.read(8)
        # OpenCV follows lists of addresses, too
        if not (begins.startswith(VIDEO_SIGNATURES) or begins[4:] in MP4_ATOMS):
            raise DataError(
                f"{self.path}: no MP4, QuickTime, AVI or Matroska file. Convert it, or store PNGs."
            )
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise DataError(
                f"{self.path}: not a video that OpenCV can read. Convert it, or store frames as PNG."
            )
        _refuse_size(
            self.path,
            *(
                capture.get(key)
                for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
            ),
        )
        frames = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        if frames > MAX_VIDEO_FRAMES:
            raise DataError(
                f"{self.path}: it says it has {frames:.0f} frames, at most {MAX_VIDEO_FRAMES} are read. Cut it."
            )
        return capture

    @property
    def fps(self) -> float:
        """Frames per second, as the file says; of slow motion that may be the speed of
        playing [1/s].
        """
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    def __len__(self) -> int:
        """Number of frames, as the file says."""
        return int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))

    def read(self, index: int) -> np.ndarray:
        """The frame number `index` in grey, uint8 (height, width)."""
        if int(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) != index:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
        good, image = self._capture.read()
        if not good:
            raise DataError(
                f"{self.path}: frame {index} cannot be read. Restore the file or leave its trial out."
            )
        return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def _image_size(path: Path) -> str:
    """Width x height of an image by its first bytes; raises DataError where these would
    unpack to gigabytes.
    """
    try:
        with Image.open(require_plain_file(path, MAX_IMAGE_BYTES)) as header:
            width, height = header.size
    except (Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
        raise DataError(
            f"{path}: the frame is missing or damaged ({error}). Restore it or leave its trial out."
        ) from error
    _refuse_size(path, width, height)
    return f"{width} x {height}"


def _refuse_size(path: Path, width: float, height: float) -> None:
    if width * height > MAX_PIXELS:
        raise DataError(
            f"{path}: it has {width:.0f} x {height:.0f} pixels, at most {MAX_PIXELS:.0f} are read. Store it smaller."
        )


class CachedImages(Images):
    """Images that are read or unpacked once where they are looked at often: as many as
    `ROOM` holds, the latest.
    """

    def __init__(self, images: Sequence[np.ndarray]) -> None:
        """images: uint8 arrays (height, width), at least one."""
        self._count = len(images)
        self._held = lru_cache(max(CACHE_BYTES // images[0].nbytes, 1))(
            images.__getitem__
        )

    def __len__(self) -> int:
        """Number of images."""
        return self._count

    def read(self, index: int) -> np.ndarray:
        """The image number `index`, uint8 (height, width), not to be written to."""
        return self._held(index)


class RecentImages(Images):
    """Images that were written a moment ago: each is given from memory the first time,
    and then read from its file.
    """

    def __init__(self, files: Images, images: Sequence[np.ndarray]) -> None:
        """files: where they were written. images: what was."""
        self._files, self._kept = files, dict(enumerate(images))

    def __len__(self) -> int:
        """Number of images."""
        return len(self._files)

    def read(self, index: int) -> np.ndarray:
        """The image number `index`, uint8 (height, width), made by who was handed over."""
        image = self._kept.pop(index, None)
        return self._files.read(index) if image is None else image


def encode_png(image: np.ndarray) -> bytes:
    """An image as PNG, without loss, packed fast rather than small: of a sensor's noise
    nothing repeats.
    """
    fast = (
        *(cv2.IMWRITE_PNG_COMPRESSION, 1),
        *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
        *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP),
    )
    good, content = cv2.imencode(".png", image, fast)
    assert good, (
        f"an image of shape {image.shape} and type {image.dtype} cannot be a PNG"
    )
    return content.tobytes()


TimedImages = tuple[np.ndarray, Images]


def video_files(folder: Path) -> list[Path]:
    """Video files of a dataset, in the order of their names."""
    found = sorted(
        p for p in (folder / "videos").glob("*") if p.suffix.lower() in VIDEO_SUFFIXES
    )
    return [require_inside(folder, path) for path in found]
