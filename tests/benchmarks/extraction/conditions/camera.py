"""Conditions of the camera.

They concern its pose, its exposure, the noise of its sensor, and frames stored with
loss.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tests.benchmarks.extraction.conditions.condition import (
    Condition,
    ExposureMoment,
    Shot,
)


@dataclass(frozen=True)
class LongExposure(Condition):
    """The shutter is open for `share` of the time from frame to frame."""

    share: float

    def change_scene(self, shot: Shot) -> Shot:
        """Return the shot by a camera that knows its exposure."""
        return replace(
            shot, camera=replace(shot.camera, exposure=self.share / shot.camera.fps)
        )


@dataclass(frozen=True)
class CroppedView(Condition):
    """The picture ends where the tip is for `share` of the film.

    It shows no more than that share of the room's height.
    """

    share: float

    def change_scene(self, shot: Shot) -> Shot:
        """Return the shot with fewer rows of the same world."""
        tips = shot.camera.pixels(shot.truth[:, -1])[:, 1]
        rows = int(np.clip(np.quantile(tips, 1 - self.share), 64, shot.camera.height))
        return replace(
            shot, camera=replace(shot.camera, height=rows), wall=shot.wall[:rows]
        )


@dataclass(frozen=True)
class SensorNoise(Condition):
    """A sensor with this noise, one sigma [grey levels]."""

    sigma: float

    def change_scene(self, shot: Shot) -> Shot:
        """Return the shot taken with another sensor."""
        return replace(shot, look=replace(shot.look, noise=self.sigma))


@dataclass(frozen=True)
class CameraShake(Condition):
    """The camera trembles.

    The picture is shifted at random in each frame, with one sigma in u and in v [px].
    """

    sigma: float

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Return the frame shifted as the camera shook.

        The truth stays, because the camera's position was not measured.
        """
        across, down = moment.rng.normal(0, self.sigma, 2)
        shift = np.array([[1, 0, across], [0, 1, down]])
        return cv2.warpAffine(
            frame,
            shift,
            frame.shape[::-1],
            flags=cv2.INTER_LANCZOS4,
            borderMode=cv2.BORDER_REPLICATE,
        )


@dataclass(frozen=True)
class HotPixels(Condition):
    """`count` pixels of the sensor that are randomly bright in half of all frames."""

    count: int
    seed: int = 3

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Return the frame with hot pixels of random brightness."""
        place = np.random.default_rng(self.seed).integers(0, frame.size, self.count)
        lit = place[moment.rng.uniform(size=self.count) < 0.5]
        hot = frame.copy()
        hot.flat[lit] = np.maximum(hot.flat[lit], moment.rng.uniform(60, 255, len(lit)))
        return hot


@dataclass(frozen=True)
class JpegCoding(Condition):
    """Each frame is coded as JPEG of a quality from 1 to 100."""

    quality: int

    def change_stored_images(
        self, images: Sequence[np.ndarray], fps: float
    ) -> Sequence[np.ndarray]:
        """Return the images after each was coded as JPEG."""
        packed = (
            cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1]
            for image in images
        )
        return [
            np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE))
            for content in packed
        ]


@dataclass(frozen=True)
class VideoCoding(Condition):
    """The film is coded as MPEG-4 video (mp4v).

    The codec predicts frames from earlier ones.
    """

    def change_stored_images(
        self, images: Sequence[np.ndarray], fps: float
    ) -> Sequence[np.ndarray]:
        """Return the images after they were written to a video file and read again."""
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "film.mp4")
            writer = cv2.VideoWriter(
                path, cv2.VideoWriter.fourcc(*"mp4v"), fps, images[0].shape[::-1]
            )
            for image in images:
                writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
            writer.release()
            reader = cv2.VideoCapture(path)
            return [cv2.cvtColor(reader.read()[1], cv2.COLOR_BGR2GRAY) for _ in images]
