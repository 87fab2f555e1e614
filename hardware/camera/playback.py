"""Files that stand in for a camera: they are played at its rate."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.images import ImageFiles, Video
from stringcast.data.schema import DataError
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class PlayedSource(Source):
    """A source made of images that are there already."""

    delay = 0.0  # they come when they are due

    @abstractmethod
    def images(self) -> Sequence[np.ndarray]:
        """All of them, in order; raises DataError where there are none."""

    def open(self, camera: Camera) -> Stream:
        """Play the images, one every 1 / camera.fps. Raises HardwareError where they
        are of another size.
        """
        try:
            images = self.images()
            rows, columns = images[0].shape[:2]
        except DataError as error:
            raise HardwareError(f"{self.name}: {error}") from error
        if (columns, rows) != (camera.width, camera.height):
            raise HardwareError(
                f"{self.name}: images are {columns}x{rows}. Set camera.width and camera.height to that."
            )
        return PlayedStream(images, camera.fps)

    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """All images, at once: nobody has to wait for a file."""
        yield from self.images()


class PlayedStream(Stream):
    """Images played; the source's clock is that of the film."""

    def __init__(self, images: Sequence[np.ndarray], fps: float) -> None:
        """From the first one."""
        self.images, self.fps = images, fps
        self.begin()

    def begin(self) -> None:
        """Begin with the first image, now."""
        self.number, self.begun = 0, time.monotonic()

    def read(self) -> Frame | None:
        """The next one, at its time."""
        if self.number == len(self.images):
            return None
        image, stamp = self.images[self.number], self.number / self.fps
        self.number += 1
        time.sleep(max(self.begun + stamp - time.monotonic(), 0.0))
        return Frame(time.monotonic(), stamp, image)

    def close(self) -> None:
        """Do nothing: no device is held."""


@dataclass(frozen=True)
class ImageFolder(PlayedSource):
    """folder: of image files, in the order of their names."""

    folder: Path

    @property
    def name(self) -> str:
        """The folder's path."""
        return f"images in {self.folder}"

    def images(self) -> Sequence[np.ndarray]:
        """The images of the folder."""
        files = sorted(
            p.name for p in self.folder.glob("*") if p.suffix.lower() in IMAGE_SUFFIXES
        )
        if not files:
            raise DataError(
                f"{self.folder}: there is no image here ({', '.join(IMAGE_SUFFIXES)}). Name the folder that has them."
            )
        return ImageFiles(self.folder, tuple(files))


@dataclass(frozen=True)
class VideoFile(PlayedSource):
    """path: of the video, played at the camera's fps whatever the file says. every: of
    its frames, how many there are from one still to the next.
    """

    path: Path
    every: Annotated[int, Field(ge=1)]

    @property
    def name(self) -> str:
        """The file's path."""
        return f"video {self.path}"

    def images(self) -> Sequence[np.ndarray]:
        """The frames of the video."""
        return Video(self.path)

    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """Every so many frames: neighbours show the same."""
        images = self.images()
        yield from (images[number] for number in range(0, len(images), self.every))
