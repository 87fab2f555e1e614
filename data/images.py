"""Sequences of images that are read one by one, from image files or from a video."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from PIL import Image

from stringcast.data.file_checks import MAX_PIXELS, require_inside, require_plain_file
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError

cv2 = LazyModule("cv2")

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv")
# [bytes] of an image file: twice the raw 16-bit colours of the largest sensors
MAX_IMAGE_BYTES = 1 << 28
MAX_VIDEO_FRAMES = 1 << 20  # frames: a quarter of an hour at 1000 a second
VIDEO_SIGNATURES = (b"RIFF", b"\x1aE\xdf\xa3")  # first bytes of AVI and Matroska
# bytes 4 to 8 of MP4 and QuickTime
MP4_ATOMS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")
CACHE_BYTES = 1 << 29  # [bytes] of images that are cached


class Images(Sequence[np.ndarray]):
    """Grey images, uint8 (height, width); an index reads one, a slice a list."""

    @abstractmethod
    def read(self, index: int) -> np.ndarray:
        """Read the image at 0 <= index < len; raise DataError if it cannot be read."""

    def __getitem__(self, index: Any) -> Any:
        """Return one image, or a list of them for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        return self.read(int(index) % len(self))


@dataclass(frozen=True)
class ImageFiles(Images):
    """Image files with paths relative to `folder`."""

    folder: Path
    files: tuple[str, ...]

    @cached_property
    def _first_size(self) -> str:
        return image_size(self.folder / self.files[0])

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.files)

    def read(self, index: int) -> np.ndarray:
        """Read an image file, uint8 (height, width)."""
        path = self.folder / self.files[index]
        size = image_size(path)
        if size != self._first_size:
            raise DataError(
                path,
                f"it has {size} pixels, the first frame of its trial has "
                f"{self._first_size}",
                "Store all alike.",
            )
        # on Windows, imread cannot open names beyond ASCII
        content = np.frombuffer(path.read_bytes(), np.uint8)
        image: np.ndarray | None = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise DataError(
                path,
                "the frame is missing or damaged",
                "Restore it or leave its trial out.",
            )
        return image


@dataclass(frozen=True)
class Video(Images):
    """The frames of a video file; quick when read in order."""

    path: Path

    @cached_property
    def _capture(self) -> Any:
        with require_plain_file(self.path).open("rb") as file:
            head = file.read(8)
        # OpenCV would also open playlists with addresses
        if not (head.startswith(VIDEO_SIGNATURES) or head[4:] in MP4_ATOMS):
            raise DataError(
                self.path,
                "no MP4, QuickTime, AVI or Matroska file",
                "Convert it, or store PNGs.",
            )
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise DataError(
                self.path,
                "not a video that OpenCV can read",
                "Convert it, or store frames as PNG.",
            )
        width = capture.get(cv2.CAP_PROP_FRAME_WIDTH)
        height = capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
        _refuse_size(self.path, width, height)
        frames = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        if frames > MAX_VIDEO_FRAMES:
            raise DataError(
                self.path,
                f"it says it has {frames:.0f} frames, at most {MAX_VIDEO_FRAMES} "
                "are read",
                "Cut it.",
            )
        return capture

    @property
    def fps(self) -> float:
        """Stated frame rate [1/s]; for slow motion, it may be that of playback."""
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    def frame_times(self, fps: float) -> np.ndarray:
        """Return the times of the frames from 0, (F,) [s]. fps: as filmed [1/s].

        Phones film at an uneven rate and store the display time of each frame. These
        times are scaled so that the median interval matches `fps`, as slow motion is
        displayed at another rate.
        """
        even = np.arange(len(self)) / fps
        shown = self._shown_times()
        usual = float(np.median(np.diff(shown))) if len(shown) > 1 else 0.0
        if len(shown) != len(even) or usual <= 0:
            return even
        uneven = (shown - shown[0]) / usual / fps
        is_even = np.abs(uneven - even).max() < 0.5 / fps
        return even if is_even else uneven

    def _shown_times(self) -> np.ndarray:
        """Read the display times of the frames, (F,) [ms]."""
        capture = cv2.VideoCapture(str(self.path))
        times = []
        while capture.grab():
            times.append(capture.get(cv2.CAP_PROP_POS_MSEC))
        return np.array(times)

    def __len__(self) -> int:
        """Return the number of frames that the file states."""
        return int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))

    def read(self, index: int) -> np.ndarray:
        """Read a frame in grey, uint8 (height, width)."""
        if int(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) != index:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
        good, image = self._capture.read()
        if not good:
            raise DataError(
                self.path,
                f"frame {index} cannot be read",
                "Restore the file or leave its trial out.",
            )
        return to_grey(image)


def to_grey(image: np.ndarray) -> np.ndarray:
    """Convert a grey or BGR image to grey, uint8 (height, width)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def image_size(path: Path) -> str:
    """Read width and height of an image from its first bytes.

    Raises DataError if it would unpack to gigabytes.
    """
    try:
        with catch_warnings():
            simplefilter("ignore", Image.DecompressionBombWarning)  # has no remedy
            with Image.open(require_plain_file(path, MAX_IMAGE_BYTES)) as header:
                width, height = header.size
    except (Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
        raise DataError(
            path,
            f"the frame is missing or damaged ({error})",
            "Restore it or leave its trial out.",
        ) from error
    _refuse_size(path, width, height)
    return f"{width} x {height}"


def _refuse_size(path: Path, width: float, height: float) -> None:
    if width * height > MAX_PIXELS:
        raise DataError(
            path,
            f"it has {width:.0f} x {height:.0f} pixels, at most {MAX_PIXELS:.0f} "
            "are read",
            "Store it smaller.",
        )


class CachedImages(Images):
    """Images with a cache of those read last, up to `CACHE_BYTES`."""

    def __init__(self, images: Sequence[np.ndarray]) -> None:
        """Cache images, uint8 (height, width), at least one."""
        self._count = len(images)
        capacity = max(CACHE_BYTES // images[0].nbytes, 1)
        self._held = lru_cache(capacity)(images.__getitem__)

    def __len__(self) -> int:
        """Return the number of images."""
        return self._count

    def read(self, index: int) -> np.ndarray:
        """Read an image, uint8 (height, width); do not modify it."""
        return self._held(index)


class RecentImages(Images):
    """Recently written images: read once from memory, later from files."""

    def __init__(self, files: Images, images: Sequence[np.ndarray]) -> None:
        """Keep `images` until they are read once; later reads use `files`."""
        self._files, self._kept = files, dict(enumerate(images))

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self._files)

    def read(self, index: int) -> np.ndarray:
        """Read an image, uint8 (height, width)."""
        image = self._kept.pop(index, None)
        return self._files.read(index) if image is None else image


def encode_png(image: np.ndarray) -> bytes:
    """Encode an image as PNG without loss, fast rather than small.

    The noise of a sensor does not compress.
    """
    options = (
        cv2.IMWRITE_PNG_COMPRESSION,
        1,
        cv2.IMWRITE_PNG_STRATEGY,
        cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
        cv2.IMWRITE_PNG_FILTER,
        cv2.IMWRITE_PNG_FILTER_UP,
    )
    good, content = cv2.imencode(".png", image, options)
    assert good, f"an image {image.shape} of {image.dtype} cannot be a PNG"
    return bytes(content)


TimedImages = tuple[np.ndarray, Images]


def video_files(folder: Path) -> list[Path]:
    """List the video files of a dataset in the order of their names."""
    files = []
    for path in sorted((folder / "videos").glob("*")):
        if path.suffix.lower() in VIDEO_SUFFIXES:
            files.append(require_inside(folder, path))
    return files
