"""A device on a pseudo-terminal, whose name is printed first."""

from __future__ import annotations

import os
import pty
import select
import signal
import threading
import time
import tty
from contextlib import suppress
from typing import Protocol

STEP = 0.0005  # [s] between looks


class UnpluggedError(Exception):
    """The cable is pulled."""


class Emulated(Protocol):
    """The interface of an emulated device."""

    def hear(self, data: bytes) -> None:
        """Bytes from the host. May raise UnpluggedError."""

    def advance(self, elapsed: float) -> bytes:
        """Let `elapsed` [s] pass; the bytes that leave meanwhile."""


def serve(device: Emulated, until: float, after: float) -> None:
    """Let the device live for `until` seconds, until SIGTERM, or as long as whoever started this. Then, or unplugged,
    it goes on alone for `after` seconds."""
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    with suppress(UnpluggedError):
        _talk(device, master, time.monotonic() + until, ended)
    os.close(slave)
    os.close(master)
    device.advance(after)


def _talk(device: Emulated, master: int, end: float, ended: threading.Event) -> None:
    last, parent = time.monotonic(), os.getppid()
    while last < end and os.getppid() == parent and not ended.is_set():
        ready, _, _ = select.select([master], [], [], STEP)
        if ready:
            device.hear(os.read(master, 4096))
        now = time.monotonic()
        out = device.advance(now - last)
        last = now
        if out:
            os.write(master, out)
