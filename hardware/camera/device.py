"""A camera that OpenCV can open: set, asked whether it obeyed, and watched for a moment
before it is trusted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field

from stringcast.hardware.camera.controls import Controls, apply_controls
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.hardware.camera.warm_up import check_stream
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

MAX_BUFFERED_FRAMES = 8  # frames that a driver may hold from before; V4L2 has 4


@dataclass(frozen=True)
class Device(Source):
    """number: of the camera. backend: OpenCV's name of the driver's interface, such as
    V4L2, DSHOW, AVFOUNDATION; ANY.

    controls: properties by OpenCV's name without CAP_PROP_, in the driver's units, set
    in this order and read back. seconds: how long stills are taken, one every
    `interval` [s].

    delay: no driver tells it. V4L2 stamps a frame when the first or the last of it
    arrives (on this host's clock; uvcvideo: the first); other backends give a time from
    the start of the stream, or none. Stamps therefore serve for the distances of
    frames, not for their place: the quickest frame is taken to have come so long after
    the middle of its exposure. About half the exposure, the readout and the transfer;
    measure it once, by a calibration motion or a flashing lamp.
    """

    number: Annotated[int, Field(ge=0)]
    backend: str
    delay: Annotated[float, Field(ge=0, le=1)]
    controls: Controls
    seconds: Annotated[float, Field(gt=0)]
    interval: Annotated[float, Field(gt=0)]

    @property
    def name(self) -> str:
        """The device's name with its number."""
        return f"camera {self.number}"

    def open(self, camera: Camera) -> Stream:
        """Set everything, and see that it obeys and gives what it should; nothing of
        that is left to the first cast.
        """
        interface = getattr(cv2, f"CAP_{self.backend}", None)
        if interface is None:
            raise HardwareError(
                f"{self.name}: OpenCV has no backend '{self.backend}'. Set source.backend to ANY, V4L2, DSHOW, MSMF or "
                "AVFOUNDATION."
            )
        capture = cv2.VideoCapture(self.number, interface)
        if not capture.isOpened():
            raise HardwareError(
                f"{self.name}: it cannot be opened. Check source.number, the cable, and that no other program uses it."
            )
        try:
            wanted = {
                "FRAME_WIDTH": camera.width,
                "FRAME_HEIGHT": camera.height,
                "FPS": camera.fps,
            }
            remarks = apply_controls(capture, self.name, wanted, self.controls)
            stream = DeviceStream(capture, self.name)
            stream.remarks = (*remarks, *check_stream(stream, self.name, camera))
        except BaseException:
            capture.release()
            raise
        return stream

    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """One every `interval`, for `seconds`, once a person is ready."""
        stream = self.open(camera)
        try:
            ready()
            stream.begin()
            begun, taken = time.monotonic(), 0
            while (
                frame := stream.read()
            ) is not None and frame.arrival_time < begun + self.seconds:
                if frame.arrival_time >= begun + taken * self.interval:
                    taken += 1
                    yield frame.image
        finally:
            stream.close()


class DeviceStream(Stream):
    """A device that is open."""

    def __init__(self, capture: cv2.VideoCapture, name: str) -> None:
        """capture: set already. name: for messages."""
        self.capture, self.name = capture, name

    def begin(self) -> None:
        """Let go of as many frames as the driver may hold from before, undecoded."""
        for _ in range(MAX_BUFFERED_FRAMES):
            if not self.capture.grab():
                return

    def read(self) -> Frame | None:
        """The next frame, each in memory of its own. One that cannot be decoded is left
        out: it counts as dropped.
        """
        while self.capture.grab():
            # decoding takes now longer, now shorter, and comes after
            arrived = time.monotonic()
            good, image = self.capture.retrieve()
            if good:
                stamp = self.capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                return Frame(arrived, stamp if stamp > 0 else float("nan"), image)
        return None

    def close(self) -> None:
        """Release the device."""
        self.capture.release()
