"""A video file as a source."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.images import Video
from stringcast.hardware.camera.played import Played
from stringcast.stages.model.camera import Camera


@dataclass(frozen=True)
class VideoFile(Played):
    """path: of the video, played at the camera's fps whatever the file says. every: of its frames, how many there are
    from one still to the next."""

    path: Path
    every: Annotated[int, Field(ge=1)]

    @property
    def name(self) -> str:
        """The file's path."""
        return f"video {self.path}"

    def images(self) -> Sequence[np.ndarray]:
        """The frames of the video."""
        return Video(self.path)

    def stills(self, camera: Camera, ready: Callable[[], object]) -> Iterator[np.ndarray]:
        """Every so many frames: neighbours show the same."""
        images = self.images()
        yield from (images[number] for number in range(0, len(images), self.every))
