"""A camera that OpenCV can open, or a film standing in for one: frames with the times they came."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np

from stages.model.camera import Camera
from stages.roles import HardwareError, Recording


@dataclass
class OpenCvCamera:
    """Fills `stages.roles.CameraDevice`; films on a thread of its own.

    source: a device number, or the path of a video, which is played at the camera's fps.
    delay: from the middle of the exposure to the frame's arrival [s], to be measured once.
    """

    camera: Camera
    source: int | str
    delay: float
    capture: cv2.VideoCapture | None = None
    filming: threading.Event = field(default_factory=threading.Event)
    thread: threading.Thread | None = None
    frames: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def __enter__(self) -> Self:
        """Open the device and see that it gives frames of the size the settings promise."""
        self.capture = cv2.VideoCapture(self.source)
        self.capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.camera.width)
        self.capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.camera.height)
        self.capture.set(cv2.CAP_PROP_FPS, self.camera.fps)
        good, image = self.capture.read()
        if not good:
            self.capture.release()
            raise HardwareError(f"camera {self.source}: it gives no frame. Check hardware.source and the cable.")
        if image.shape[:2] != (self.camera.height, self.camera.width):
            self.capture.release()
            size = f"{image.shape[1]}x{image.shape[0]}"
            raise HardwareError(f"camera {self.source}: frames are {size}. Set camera.width and camera.height to that.")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End filming and release the device."""
        self._end()
        if self.capture is not None:
            self.capture.release()
            self.capture = None

    def start(self) -> None:
        """Film until `stop`."""
        self.frames.clear()
        self.filming.set()
        self.thread = threading.Thread(target=self._film, daemon=True)
        self.thread.start()

    def stop(self, moved_at: float) -> Recording:
        """The frames, timed from the start of the movement."""
        self._end()
        if not self.frames:
            raise HardwareError(f"camera {self.source}: no frame came during the movement. Check the device.")
        times = np.array([t for t, _ in self.frames]) - moved_at - self.delay
        return Recording(times, [image for _, image in self.frames])

    def _film(self) -> None:
        assert self.capture is not None
        film = Path(str(self.source)).is_file()  # a device waits for its frames by itself
        begun = time.monotonic()
        while self.filming.is_set():
            good, image = self.capture.read()
            if not good:
                break
            if film:
                time.sleep(max(begun + len(self.frames) / self.camera.fps - time.monotonic(), 0.0))
            self.frames.append((time.monotonic(), cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))

    def _end(self) -> None:
        self.filming.clear()
        if self.thread is not None:
            self.thread.join(timeout=2.0)
            self.thread = None
