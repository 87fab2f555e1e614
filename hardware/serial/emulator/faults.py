"""Faults on the line: each takes a frame and returns the bytes that arrive, and how much later [s]."""

from __future__ import annotations

from collections.abc import Callable

LATE = 0.03  # [s]
PAST_NEXT = 0.0075  # [s] after which the next frame, a tick behind, has arrived


def whole(frame: bytes) -> list[tuple[float, bytes]]:
    """No fault."""
    return [(0.0, frame)]


def drop(frame: bytes) -> list[tuple[float, bytes]]:
    """The frame is lost."""
    return []


def duplicate(frame: bytes) -> list[tuple[float, bytes]]:
    """The frame arrives twice."""
    return [(0.0, frame), (0.0, frame)]


def corrupt(frame: bytes) -> list[tuple[float, bytes]]:
    """A bit is flipped."""
    middle = len(frame) // 2
    return [(0.0, frame[:middle] + bytes([frame[middle] ^ 0x10]) + frame[middle + 1 :])]


def delay(frame: bytes) -> list[tuple[float, bytes]]:
    """The frame arrives several ticks late."""
    return [(LATE, frame)]


def reorder(frame: bytes) -> list[tuple[float, bytes]]:
    """The next one overtakes it."""
    return [(PAST_NEXT, frame)]


LINE: dict[str, Callable[[bytes], list[tuple[float, bytes]]]] = {
    fault.__name__: fault for fault in (drop, duplicate, corrupt, delay, reorder)
}
