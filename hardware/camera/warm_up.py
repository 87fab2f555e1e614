"""A moment's look at what a device gives, before anything moves by it: size, rate, life
and steady brightness.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from stringcast.hardware.camera.source import Frame, Stream
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

LOOK_S = 0.5  # [s] that it takes
MIN_FRAMES = 10  # frames of it
TIMEOUT_S = 5.0  # [s] until that many must have come
RATE_TOLERANCE = 0.05  # by which frames may come at another rate than they should
# by which a still scene may change in brightness: a lamp's flicker is less over a
# quarter of the time
BRIGHTNESS_TOLERANCE = 0.03


def check_stream(stream: Stream, name: str, camera: Camera) -> tuple[str, ...]:
    """Refuse a stream that is not what `camera` says; returns what seems doubtful.
    name: for messages.
    """
    stream.begin()
    frames = _read_briefly(stream)
    if len(frames) < MIN_FRAMES:
        raise HardwareError(
            f"{name}: {len(frames)} frame(s) came in {TIMEOUT_S:g} s. Check the cable and the light, and that no other "
            "program uses it."
        )
    shape, kind = frames[0].image.shape, frames[0].image.dtype
    if kind != np.uint8 or shape[2:] not in ((), (3,)):
        raise HardwareError(
            f"{name}: its images are {kind} of shape {shape}, neither grey nor BGR of 8 bits. Choose another format "
            "(source.controls.FOURCC) or another source.backend."
        )
    if shape[:2] != (camera.height, camera.width):
        raise HardwareError(
            f"{name}: it was asked for {camera.width}x{camera.height} and gives {shape[1]}x{shape[0]}. Set "
            "camera.width and camera.height to what it can do, and calibrate at that size."
        )
    rate = (len(frames) - 1) / max(
        frames[-1].arrival_time - frames[0].arrival_time, 1e-9
    )
    if abs(rate / camera.fps - 1) > RATE_TOLERANCE:
        raise HardwareError(
            f"{name}: {rate:.1f} frames come in a second, camera.fps is {camera.fps:g}. Shorten the exposure, choose a "
            "quicker format (source.controls.FOURCC) or a smaller size, or set camera.fps to what comes."
        )
    if all(np.array_equal(frame.image, frames[0].image) for frame in frames[1:]):
        raise HardwareError(
            f"{name}: its images are all the same to the bit, as no sensor's are. Take the lid off the lens, give "
            "it light, and plug it in anew."
        )
    return tuple(_brightness_remarks(frames))


def _read_briefly(stream: Stream) -> Sequence[Frame]:
    """The frames of a moment."""
    begun = time.monotonic()
    frames: list[Frame] = []
    while time.monotonic() - begun < (
        LOOK_S if len(frames) >= MIN_FRAMES else TIMEOUT_S
    ):
        frame = stream.read()
        if frame is None:
            break
        frames.append(frame)
    return frames


def _brightness_remarks(frames: Sequence[Frame]) -> Sequence[str]:
    """The fault of a brightness that changes, in words; empty where it does not."""
    quarter = len(frames) // 4
    first, last = (
        np.mean([frame.image.mean() for frame in part])
        for part in (frames[:quarter], frames[-quarter:])
    )
    if abs(last - first) <= BRIGHTNESS_TOLERANCE * max(first, last):
        return ()
    return (
        f"brightness changed by {abs(last - first) / max(first, last):.0%} while nothing moved: is exposure locked?",
    )
