"""Coding: what is left of frames that were stored with loss."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stringcast.hardware.virtual.conditions.condition import Condition


@dataclass(frozen=True)
class Jpeg(Condition):
    """Each frame as JPEG of a quality from 1 to 100."""

    quality: int

    def stored(self, images: Sequence[np.ndarray], fps: float) -> Sequence[np.ndarray]:
        """The images after each was coded as JPEG."""
        packed = (cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1] for image in images)
        return [np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)) for content in packed]


@dataclass(frozen=True)
class Video(Condition):
    """The film as MPEG-4 video (mp4v), in which frames are predicted from those before them."""

    def stored(self, images: Sequence[np.ndarray], fps: float) -> Sequence[np.ndarray]:
        """The images after they were written to a video file and read again."""
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "film.mp4")
            writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"mp4v"), fps, images[0].shape[::-1])
            for image in images:
                writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
            writer.release()
            reader = cv2.VideoCapture(path)
            return [cv2.cvtColor(reader.read()[1], cv2.COLOR_BGR2GRAY) for _ in images]
