"""Image files and videos that replace a camera, played at its rate."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import PositiveInt

from stringcast.data.images import ImageFiles, Video
from stringcast.data.schema import DataError
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class PlayedSource(Source):
    """A source of stored images."""

    delay = 0.0  # images arrive when they are due

    @abstractmethod
    def images(self) -> Sequence[np.ndarray]:
        """Open the images in order; raise DataError if there are none."""

    def open(self, camera: Camera) -> Stream:
        """Play the images, one every 1 / camera.fps.

        Raises HardwareError for images of another size.
        """
        try:
            images = self.images()
            rows, columns = images[0].shape[:2]
        except DataError as error:
            raise HardwareError(self.name, str(error)) from error
        if (columns, rows) != (camera.width, camera.height):
            raise HardwareError(
                self.name,
                f"images are {columns}x{rows}",
                "Set camera.width and camera.height to that.",
            )
        return PlayedStream(images, camera.fps)

    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """Yield all images without a wait."""
        yield from self.images()


@dataclass
class PlayedStream(Stream):
    """Images being played, stamped with times of the film.

    number: index of the next image. start: host time of the first image [s].
    """

    images: Sequence[np.ndarray]
    fps: float
    number: int = 0
    start: float = field(default_factory=time.monotonic)

    def begin(self) -> None:
        """Start the playback now."""
        self.number, self.start = 0, time.monotonic()

    def read(self) -> Frame | None:
        """Wait until the next image is due and return it."""
        if self.number == len(self.images):
            return None
        image, stamp = self.images[self.number], self.number / self.fps
        self.number += 1
        time.sleep(max(self.start + stamp - time.monotonic(), 0.0))
        return Frame(time.monotonic(), stamp, image)

    def close(self) -> None:
        """Do nothing: no device is held."""


@dataclass(frozen=True)
class ImageFolder(PlayedSource):
    """A folder of image files, in the order of their names."""

    folder: Path

    @property
    def name(self) -> str:
        """The path of the folder with the images."""
        return f"images in {self.folder}"

    def images(self) -> Sequence[np.ndarray]:
        """Open the images of the folder."""
        names = []
        for path in sorted(self.folder.glob("*")):
            if path.suffix.lower() in IMAGE_SUFFIXES:
                names.append(path.name)
        if not names:
            raise DataError(
                self.folder,
                f"there is no image here ({', '.join(IMAGE_SUFFIXES)})",
                "Name the folder that has them.",
            )
        return ImageFiles(self.folder, tuple(names))


@dataclass(frozen=True)
class VideoFile(PlayedSource):
    """A video, played at the camera's fps instead of its own.

    every: number of frames between stills.
    """

    path: Path
    every: PositiveInt

    @property
    def name(self) -> str:
        """The path of the video file."""
        return f"video {self.path}"

    def images(self) -> Sequence[np.ndarray]:
        """Open the frames of the video."""
        return Video(self.path)

    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """Yield every n-th frame (`every`), as neighbours are nearly equal."""
        images = self.images()
        for number in range(0, len(images), self.every):
            yield images[number]
