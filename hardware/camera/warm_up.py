"""Check of a camera before a movement: size, rate, changing images, brightness."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from stringcast.hardware.camera.source import Frame, Stream
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.camera import Camera

LOOK_S = 0.5  # [s] of the check
MIN_FRAMES = 10  # needed for the check
TIMEOUT_S = 5.0  # [s] for that many frames
RATE_TOLERANCE = 0.05  # relative error of the frame rate
# relative change in brightness of a still scene; flicker averages out over a quarter of
# the check
BRIGHTNESS_TOLERANCE = 0.03


def check_stream(stream: Stream, name: str, camera: Camera) -> tuple[str, ...]:
    """Refuse a stream that differs from the settings.

    Parameters
    ----------
    stream
        The open source.
    name
        Its name for messages.
    camera
        The required size and rate.

    Returns
    -------
    tuple of str
        Remarks on doubtful properties.

    Raises
    ------
    HardwareError
        If no frames arrive, or they have another format, size or rate, or never change.
    """
    stream.begin()
    frames = _read_briefly(stream)
    if len(frames) < MIN_FRAMES:
        raise HardwareError(
            name,
            f"{len(frames)} frame(s) came in {TIMEOUT_S:g} s",
            "Check the cable and the light, and that no other program uses it.",
        )
    shape, kind = frames[0].image.shape, frames[0].image.dtype
    if kind != np.uint8 or shape[2:] not in ((), (3,)):
        raise HardwareError(
            name,
            f"its images are {kind} of shape {shape}, neither grey nor BGR of 8 bits",
            "Choose another format (source.controls.FOURCC) or another source.backend.",
        )
    if shape[:2] != (camera.height, camera.width):
        raise HardwareError(
            name,
            f"it was asked for {camera.width}x{camera.height} and gives "
            f"{shape[1]}x{shape[0]}",
            "Set camera.width and camera.height to what it can do, and "
            "calibrate at that size.",
        )
    duration = max(frames[-1].arrival_time - frames[0].arrival_time, 1e-9)
    rate = (len(frames) - 1) / duration
    if abs(rate / camera.fps - 1) > RATE_TOLERANCE:
        raise HardwareError(
            name,
            f"{rate:.1f} frames come in a second, camera.fps is {camera.fps:g}",
            "Shorten the exposure, choose a quicker format "
            "(source.controls.FOURCC) or a smaller size, or set camera.fps to "
            "what comes.",
        )
    if all(np.array_equal(frame.image, frames[0].image) for frame in frames[1:]):
        raise HardwareError(
            name,
            "its images are all the same to the bit, as no sensor's are",
            "Take the lid off the lens, give it light, and plug it in again.",
        )
    return _brightness_remarks(frames)


def _read_briefly(stream: Stream) -> Sequence[Frame]:
    """Read frames for LOOK_S, longer if they are too few."""
    start = time.monotonic()
    frames: list[Frame] = []
    while True:
        duration = LOOK_S if len(frames) >= MIN_FRAMES else TIMEOUT_S
        if time.monotonic() - start >= duration:
            break
        frame = stream.read()
        if frame is None:
            break
        frames.append(frame)
    return frames


def _brightness_remarks(frames: Sequence[Frame]) -> tuple[str, ...]:
    """Return a remark if brightness changes from the first to the last quarter."""
    brightness = [frame.image.mean() for frame in frames]
    quarter = len(frames) // 4
    first, last = np.mean(brightness[:quarter]), np.mean(brightness[-quarter:])
    change, largest = abs(last - first), max(first, last)
    if change <= BRIGHTNESS_TOLERANCE * largest:
        return ()
    return (
        f"brightness changed by {change / largest:.0%} while nothing moved: "
        "is exposure locked?",
    )
