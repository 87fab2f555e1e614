"""Filming in the background.

One thread only takes frames from the driver, another makes them grey.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.hardware.camera.record import RawFilm, build_recording
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.stages.execute.interfaces import HardwareError, Recording
from stringcast.stages.model.camera import Camera

cv2 = LazyModule("cv2")

# frames that wait to be made grey; a further one is dropped and counted, so that the
# memory does not fill
QUEUE_FRAMES = 64
FIRST_FRAME_TIMEOUT_S = 5.0  # [s] in which the first frame must come
# [s] beyond the delay that the last frames may take
LAST_FRAME_MARGIN_S = 0.5
READ_TIMEOUT_S = 2.0  # [s] that a read in progress may take to end


@dataclass
class FilmingCamera:
    """A camera that films any source, which fills the role `CameraDevice`.

    Attributes
    ----------
    camera
        The camera as it should be.
    source
        Where frames come from.
    most_lost
        Fraction of dropped or repeated frames above which a trial is invalid.
    """

    camera: Camera
    source: Source
    most_lost: float
    stream: Stream | None = None
    film: BackgroundFilm | None = None

    def __enter__(self) -> Self:
        """Open the source and check that it gives what the settings promise."""
        self.stream = self.source.open(self.camera)
        return self

    def __exit__(self, *error: object) -> None:
        """End filming and close the source."""
        if self.film is not None:
            self.film.close()
        elif self.stream is not None:
            self.stream.close()
        self.film = self.stream = None

    def start(self) -> None:
        """Film until `stop`, and return once the first frame is there.

        Raises
        ------
        HardwareError
            If no frame comes.
        """
        assert self.stream is not None
        self.film = BackgroundFilm(self.stream)
        if not self.film.wait_for(-np.inf, FIRST_FRAME_TIMEOUT_S):
            reason = self.film.failure or f"waited {FIRST_FRAME_TIMEOUT_S:g} s"
            raise HardwareError(
                f"{self.source.name}: no frame came ({reason}). "
                "Check the device and its cable."
            )

    def stop(self, moved_at: float) -> Recording:
        """End filming once all frames exposed until now have come.

        Parameters
        ----------
        moved_at
            Host time of the start of the movement (time.monotonic) [s].

        Returns
        -------
        Recording
            The frames, timed from the start of the movement.
        """
        assert self.film is not None
        assert self.stream is not None
        end_time = time.monotonic()
        delay = self.source.delay
        self.film.wait_for(end_time + delay, delay + LAST_FRAME_MARGIN_S)
        frames = self.film.end()
        remarks = self.stream.remarks
        overrun = self.film.overrun
        if overrun:
            remarks = (*remarks, f"the host was too slow for {overrun} frame(s)")
        film = RawFilm(frames, end_time - moved_at, self.film.failure, remarks)
        return build_recording(
            film, moved_at, delay, 1 / self.camera.fps, self.most_lost
        )


class BackgroundFilm:
    """The recording of one film by two threads.

    Attributes
    ----------
    failure
        Why no more frames come; empty if they do.
    overrun
        Number of frames for which the queue had no room.
    """

    def __init__(self, stream: Stream) -> None:
        """Begin filming at once."""
        self.stream = stream
        self.failure, self.overrun = "", 0
        self._is_reading = True  # the stream may still be read
        self._close_after_reading = False
        self._is_over = False  # no more frames will be kept
        self._frames: list[Frame] = []
        self._goes_on = threading.Event()
        self._goes_on.set()
        self._queue: queue.Queue[Frame | None] = queue.Queue(QUEUE_FRAMES)
        self._changed = threading.Condition()
        self.threads = (
            threading.Thread(target=self._read_frames, daemon=True),
            threading.Thread(target=self._convert_frames, daemon=True),
        )
        for thread in self.threads:
            thread.start()

    def wait_for(self, arrival: float, timeout: float) -> bool:
        """Wait for a frame that arrived at `arrival` (time.monotonic) or later.

        Returns whether there is one after at most `timeout` [s].
        """

        def has_arrived() -> bool:
            frames = self._frames
            return bool(frames) and frames[-1].arrival_time >= arrival

        with self._changed:
            self._changed.wait_for(lambda: self._is_over or has_arrived(), timeout)
            return has_arrived()

    def end(self) -> list[Frame]:
        """End filming and return the frames."""
        self._goes_on.clear()
        deadline = time.monotonic() + READ_TIMEOUT_S
        for thread in self.threads:
            thread.join(max(deadline - time.monotonic(), 0.0))
        with self._changed:
            return list(self._frames)

    def close(self) -> None:
        """End filming and close the stream.

        A stream that is still being read is closed when that ends: to close a device
        during a read can crash the program.
        """
        self.end()
        with self._changed:
            self._close_after_reading = self._is_reading
            if not self._is_reading:
                self.stream.close()

    def _read_frames(self) -> None:
        """Take frames from the driver and queue them.

        It does nothing else, for a frame that waits in the driver may be lost.
        """
        try:
            self.stream.begin()
            while self._goes_on.is_set():
                frame = self.stream.read()
                if frame is None:
                    self.failure = "it gives no more frames"
                    break
                try:
                    self._queue.put_nowait(frame)
                except queue.Full:
                    self.overrun += 1
        except Exception as error:  # of any kind: no other thread would hear of it
            self.failure = str(error) or type(error).__name__
        finally:
            with self._changed:
                self._is_reading = False
                if self._close_after_reading:
                    self.stream.close()
            self._queue.put(None)

    def _convert_frames(self) -> None:
        """Make frames grey and keep them until there are no more or one fails."""
        try:
            while (frame := self._queue.get()) is not None:
                grey = replace(frame, image=to_grey(frame.image))
                with self._changed:
                    self._frames.append(grey)
                    self._changed.notify_all()
        except Exception as error:  # as above
            self.failure = str(error) or type(error).__name__
            self._goes_on.clear()
            # the other thread must not wait for room
            while self._queue.get() is not None:
                pass
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()


def to_grey(image: np.ndarray) -> np.ndarray:
    """Convert a grey or BGR image to grey, uint8 (height, width)."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
