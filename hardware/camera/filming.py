"""Filming in the background.

One thread only reads frames from the driver; another converts them to grey.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from stringcast.data.images import to_grey
from stringcast.hardware.camera.record import RawFilm, build_recording
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.stages.execute.interfaces import HardwareError, Recording
from stringcast.stages.model.camera import Camera

# queue of frames to convert; further ones are dropped and counted to limit memory
QUEUE_FRAMES = 64
FIRST_FRAME_TIMEOUT_S = 5.0  # [s] for the first frame
# [s] beyond the delay to wait for the last frames
LAST_FRAME_MARGIN_S = 0.5
READ_TIMEOUT_S = 2.0  # [s] to wait for a read in progress


@dataclass
class FilmingCamera:
    """A camera that films any source; implements `CameraDevice`.

    Attributes
    ----------
    camera
        The required camera.
    source
        Source of frames.
    most_lost
        Fraction of dropped or repeated frames above which a trial is invalid.
    """

    camera: Camera
    source: Source
    most_lost: float
    stream: Stream | None = None
    film: BackgroundFilm | None = None

    def __enter__(self) -> Self:
        """Open the source and check it against the settings."""
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
        """Film until `stop`; return after the first frame.

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
                self.source.name,
                f"no frame came ({reason})",
                "Check the device and its cable.",
            )

    def stop(self, moved_at: float) -> Recording:
        """End filming when all frames exposed so far have arrived.

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
        Why no more frames arrive; empty if they do.
    overrun
        Number of frames dropped because the queue was full.
    """

    def __init__(self, stream: Stream) -> None:
        """Begin filming at once."""
        self.stream = stream
        self.failure, self.overrun = "", 0
        self._is_reading = True  # the stream may be in use
        self._close_after_reading = False
        self._is_over = False  # further frames are ignored
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

        Returns whether one arrived within `timeout` [s].
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

        If a read is in progress, the stream is closed afterwards: closing a device
        during a read can crash the program.
        """
        self.end()
        with self._changed:
            self._close_after_reading = self._is_reading
            if not self._is_reading:
                self.stream.close()

    def _read_frames(self) -> None:
        """Take frames from the driver and queue them.

        It does nothing else, as a frame that waits in the driver may be lost.
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
        except Exception as error:  # any kind, to report it in the main thread
            self.failure = str(error) or type(error).__name__
        finally:
            with self._changed:
                self._is_reading = False
                if self._close_after_reading:
                    self.stream.close()
            self._queue.put(None)

    def _convert_frames(self) -> None:
        """Convert frames to grey and store them, until the end or a failure."""
        try:
            while (frame := self._queue.get()) is not None:
                grey = replace(frame, image=to_grey(frame.image))
                with self._changed:
                    self._frames.append(grey)
                    self._changed.notify_all()
        except Exception as error:  # as above
            self.failure = str(error) or type(error).__name__
            self._goes_on.clear()
            # do not block the other thread
            while self._queue.get() is not None:
                pass
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()
