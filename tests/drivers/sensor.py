"""A fake capture device that films its own clock, with optional faults."""

import time

import cv2
import numpy as np

from stringcast.hardware.camera.device import MAX_BUFFERED_FRAMES


class Sensor:
    """A replacement of cv2.VideoCapture; frame k is exposed at `begun` + k / fps.

    lost: frames that are never delivered. again: frames replaced by the previous one.
    held: delay by frame [s]. dies: first missing frame. stamps: whether exposure times
    are reported. ignored, dumb: properties that keep their value or refuse to be set.
    size: (width, height), independent of the request. quiet: no noise. decoding:
    decoding time by frame [s]. damaged: undecodable frames.
    """

    def __init__(
        self,
        fps=50.0,
        size=(32, 24),
        lost=(),
        again=(),
        held=None,
        dies=None,
        stamps=False,
        quiet=False,
    ):
        self.fps, self.size, self.lost, self.again = fps, size, set(lost), set(again)
        self.held, self.dies, self.stamps, self.quiet = held or {}, dies, stamps, quiet
        self.properties, self.ignored, self.dumb = {}, set(), set()
        self.rng = np.random.default_rng(0)
        self.begun = time.monotonic()
        self.next = 0
        self.seen = None
        self.released = False
        # first frame of the film; tests count from it
        self.counting_from = None
        self.decoding, self.damaged = lambda number: 0.0, set()

    def isOpened(self):  # noqa: N802
        return True

    def release(self):
        self.released = True

    def set(self, key, value):
        if key in self.dumb:
            return False
        self.properties.setdefault(key, 0.0)
        if key not in self.ignored:
            self.properties[key] = value
        return True

    def get(self, key):
        if key == cv2.CAP_PROP_POS_MSEC:
            return self.exposed_at(self.last) * 1e3 if self.stamps else 0.0
        return 0.0 if key in self.dumb else self.properties.get(key, 0.0)

    def film(self):
        """Start a film; frames in `lost`, `again`, `held` and `dies` count from now."""
        self.next = int((time.monotonic() - self.begun) * self.fps) + 1
        self.counting_from = self.next + MAX_BUFFERED_FRAMES

    def exposed_at(self, number):
        return self.begun + number / self.fps

    def grab(self):
        now = int((time.monotonic() - self.begun) * self.fps)
        self.next = max(self.next, now - 3)  # a driver buffers four frames
        number = self.next
        of_film = None if self.counting_from is None else number - self.counting_from
        while of_film in self.lost:
            number, of_film = number + 1, of_film + 1
        if self.dies is not None and of_film is not None and of_film >= self.dies:
            return False
        due = self.exposed_at(number) + self.held.get(of_film, 0.0)
        time.sleep(max(due - time.monotonic(), 0.0))
        self.last, self.next = number, number + 1
        if of_film not in self.again or self.seen is None:
            self.seen = self.picture(number)
        return True

    def retrieve(self):
        time.sleep(self.decoding(self.last))
        if (
            self.counting_from is not None
            and self.last - self.counting_from in self.damaged
        ):
            return False, None
        return True, self.seen.copy()

    def picture(self, number):
        """Return noise with the frame number encoded in two rows."""
        image = np.full((*self.size[::-1], 3), 100, np.uint8)
        if not self.quiet:
            image += self.rng.integers(0, 20, image.shape, dtype=np.uint8)
        for row in (0, 1):
            image[row, :8] = [
                [255 * (number >> (8 * row + bit) & 1)] * 3 for bit in range(8)
            ]
        return image


def number_in(image):
    bits = (image[:2, :8] > 127).astype(int)
    return int((bits * 2 ** np.arange(16).reshape(2, 8)).sum())
