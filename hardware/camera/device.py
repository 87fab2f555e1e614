"""A camera opened by OpenCV, configured and checked before use."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat

from stringcast.data.lazy_module import LazyModule
from stringcast.hardware.camera.controls import Controls, apply_controls
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.hardware.camera.warm_up import check_stream
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

cv2 = LazyModule("cv2")

MAX_BUFFERED_FRAMES = 8  # old frames in a driver's buffer; V4L2 has 4


@dataclass(frozen=True)
class Device(Source):
    """The settings of a camera that OpenCV can open.

    No driver reports the delay. V4L2 stamps a frame when its first or last byte
    arrives, on the host's clock (uvcvideo: the first). Other backends give times from
    the start of the stream, or none. Stamps therefore give intervals between frames,
    not absolute times.

    Attributes
    ----------
    number
        Number of the camera in OpenCV.
    backend
        OpenCV's name of the driver's interface, such as V4L2, DSHOW, AVFOUNDATION; or
        ANY.
    delay
        Time from mid-exposure to the arrival of the quickest frame [s]: about half the
        exposure, the readout and the transfer. Measure it once, with a calibration
        motion or a flashing lamp.
    controls
        Properties by OpenCV's name without CAP_PROP_, in the driver's units, set in
        this order and read back.
    seconds
        Duration of taking stills [s].
    interval
        Time from one still to the next [s].
    """

    number: NonNegativeInt
    backend: str
    delay: Annotated[float, Field(ge=0, le=1)]
    controls: Controls
    seconds: PositiveFloat
    interval: PositiveFloat

    @property
    def name(self) -> str:
        """The camera with its number."""
        return f"camera {self.number}"

    def open(self, camera: Camera) -> Stream:
        """Open and set the camera, and check its frames.

        Parameters
        ----------
        camera
            The required size and rate.

        Returns
        -------
        Stream
            The open camera.

        Raises
        ------
        HardwareError
            If the camera cannot be opened, or has another setting, size or rate.
        """
        interface = getattr(cv2, f"CAP_{self.backend}", None)
        if interface is None:
            raise HardwareError(
                self.name,
                f"OpenCV has no backend '{self.backend}'",
                "Set source.backend to ANY, V4L2, DSHOW, MSMF or AVFOUNDATION.",
            )
        capture = cv2.VideoCapture(self.number, interface)
        if not capture.isOpened():
            raise HardwareError(
                self.name,
                "it cannot be opened",
                "Check source.number, the cable, and that no other program uses it.",
            )
        try:
            form = {
                "FRAME_WIDTH": camera.width,
                "FRAME_HEIGHT": camera.height,
                "FPS": camera.fps,
            }
            remarks = apply_controls(capture, self.name, form, self.controls)
            stream = DeviceStream(capture)
            stream.remarks = (*remarks, *check_stream(stream, self.name, camera))
        except BaseException:
            capture.release()
            raise
        return stream

    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """Take one still every `interval`, for `seconds`, once the user is ready."""
        stream = self.open(camera)
        try:
            ready()
            stream.begin()
            start, count = time.monotonic(), 0
            while (frame := stream.read()) is not None:
                if frame.arrival_time >= start + self.seconds:
                    break
                if frame.arrival_time >= start + count * self.interval:
                    count += 1
                    yield frame.image
        finally:
            stream.close()


@dataclass
class DeviceStream(Stream):
    """A stream of frames from an open camera that is already set."""

    capture: Any

    def begin(self) -> None:
        """Drop old frames from the driver's buffer."""
        for _ in range(MAX_BUFFERED_FRAMES):
            if not self.capture.grab():
                return

    def read(self) -> Frame | None:
        """Read the next frame into new memory.

        Undecodable frames count as dropped.
        """
        while self.capture.grab():
            # before decoding, whose duration varies
            arrival = time.monotonic()
            good, image = self.capture.retrieve()
            if good:
                stamp = self.capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                return Frame(arrival, stamp if stamp > 0 else np.nan, image)
        return None

    def close(self) -> None:
        """Close the camera device and release it."""
        self.capture.release()
