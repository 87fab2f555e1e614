"""Filming in the background: one thread takes frames from the driver at once, another
makes them grey.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

import cv2
import numpy as np

from stringcast.hardware.camera.record import RawFilm, build_recording
from stringcast.hardware.camera.source import Frame, Source, Stream
from stringcast.stages.execute.interfaces import HardwareError, Recording
from stringcast.stages.model.camera import Camera

# frames that wait to be made grey; then one is lost, and counted, rather than all
# memory
QUEUE_FRAMES = 64
FIRST_FRAME_TIMEOUT_S = 5.0  # [s] in which the first frame must come
# [s] beyond the delay for which the last frames are waited for
LAST_FRAME_MARGIN_S = 0.5
READ_TIMEOUT_S = 2.0  # [s] that a read under way may take to end


@dataclass
class FilmingCamera:
    """Fills `stages.execute.interfaces.CameraDevice` with any source.

    most_lost: share of frames dropped or repeated above which a trial is invalid.
    """

    camera: Camera
    source: Source
    most_lost: float
    stream: Stream | None = None
    film: BackgroundFilm | None = None

    def __enter__(self) -> Self:
        """Open the source and see that it gives what the settings promise."""
        self.stream = self.source.open(self.camera)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End filming and let go of the source."""
        if self.film is not None:
            self.film.close()
        elif self.stream is not None:
            self.stream.close()
        self.film = self.stream = None

    def start(self) -> None:
        """Film until `stop`; the first frame is there when this returns."""
        assert self.stream is not None
        self.film = BackgroundFilm(self.stream)
        if not self.film.wait_for(-np.inf, FIRST_FRAME_TIMEOUT_S):
            why = self.film.died or f"waited {FIRST_FRAME_TIMEOUT_S:g} s"
            raise HardwareError(
                f"{self.source.name}: no frame came ({why}). Check the device and its cable."
            )

    def stop(self, moved_at: float) -> Recording:
        """The frames, timed from the start of the movement, with those that were
        exposed until now.
        """
        assert self.film is not None
        assert self.stream is not None
        until = time.monotonic()
        self.film.wait_for(
            until + self.source.delay, self.source.delay + LAST_FRAME_MARGIN_S
        )
        frames, died, overrun = self.film.end(), self.film.died, self.film.overrun
        remarks = (
            *self.stream.remarks,
            *([f"the host was too slow for {overrun} frame(s)"] if overrun else []),
        )
        film = RawFilm(frames, until - moved_at, died, remarks)
        return build_recording(
            film, moved_at, self.source.delay, 1 / self.camera.fps, self.most_lost
        )


class BackgroundFilm:
    """One film in the making. died: why no more frames come; empty if they do. overrun:
    frames for which there was no room. reading: whether somebody may still be reading
    the stream, who lets go of it in the end if it was left to him. over: no more frames
    are kept.
    """

    def __init__(self, stream: Stream) -> None:
        """Begin filming at once."""
        self.stream = stream
        self.died, self.overrun = "", 0
        self.reading, self.left, self.over = True, False, False
        self.frames: list[Frame] = []
        self.more = threading.Event()
        self.more.set()
        self.waiting: queue.Queue[Frame | None] = queue.Queue(QUEUE_FRAMES)
        self.came = threading.Condition()
        self.threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._read_frames, self._convert_frames)
        ]
        for thread in self.threads:
            thread.start()

    def wait_for(self, arrival: float, most: float) -> bool:
        """Whether a frame has come that arrived at `arrival` (time.monotonic) or later,
        after waiting `most` [s].
        """
        with self.came:
            self.came.wait_for(
                lambda: (
                    self.over
                    or (self.frames and self.frames[-1].arrival_time >= arrival)
                ),
                most,
            )
            return bool(self.frames) and self.frames[-1].arrival_time >= arrival

    def end(self) -> list[Frame]:
        """Film no more; what there is."""
        self.more.clear()
        until = time.monotonic() + READ_TIMEOUT_S
        for thread in self.threads:
            thread.join(max(until - time.monotonic(), 0.0))
        with self.came:
            return list(self.frames)

    def close(self) -> None:
        """Film no more, and let go of the stream: here, or where it is still being read
        once that ends, for to let go of a device that is being read can end the
        program.
        """
        self.end()
        with self.came:
            self.left = self.reading
            if not self.reading:
                self.stream.close()

    def _read_frames(self) -> None:
        """Take frames from the driver as they come, and nothing else: a frame that must
        wait there may be lost.
        """
        try:
            self.stream.begin()
            while self.more.is_set():
                frame = self.stream.read()
                if frame is None:
                    self.died = "it gives no more frames"
                    break
                try:
                    self.waiting.put_nowait(frame)
                except queue.Full:
                    self.overrun += 1
        except Exception as error:  # whatever it is: nobody else would hear of it
            self.died = str(error) or type(error).__name__
        finally:
            with self.came:
                self.reading = False
                # `close` could not let go of the stream while it was read
                if self.left:
                    self.stream.close()
            self.waiting.put(None)

    def _convert_frames(self) -> None:
        """Make frames grey and keep them, until there are no more, or one that cannot
        be.
        """
        try:
            while (frame := self.waiting.get()) is not None:
                kept = replace(frame, image=to_grey(frame.image))
                with self.came:
                    self.frames.append(kept)
                    self.came.notify_all()
        except Exception as error:  # as above
            self.died = str(error) or type(error).__name__
            self.more.clear()
            # who takes frames must not wait for room
            while self.waiting.get() is not None:
                pass
        finally:
            with self.came:
                self.over = True
                self.came.notify_all()


def to_grey(image: np.ndarray) -> np.ndarray:
    """An image in grey, (height, width) uint8. image: grey or BGR, as the driver gave
    it.
    """
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
