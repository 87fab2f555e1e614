"""A device on a pseudo-terminal, whose name is printed first, and the command that serves one."""

from __future__ import annotations

import argparse
import os
import pty
import select
import signal
import threading
import time
import tty
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
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


def parser(prog: str, description: str | None, kinds: Collection[str]) -> argparse.ArgumentParser:
    """The parser of an emulator's command: --log, --until, and --fault, a list of (number, kind). kinds: of faults."""

    def fault(text: str) -> tuple[int, str]:
        kind, _, number = text.partition(":")
        if kind not in kinds:
            raise argparse.ArgumentTypeError(f"there is no fault '{kind}'; known are {', '.join(kinds)}")
        return int(number), kind

    made = argparse.ArgumentParser(prog=prog, description=description)
    made.add_argument("--log", type=Path, default=Path(os.devnull), help="events, a line of JSON each")
    at = f"at the N-th velocity command: {', '.join(kinds)}"
    made.add_argument("--fault", action="append", default=[], type=fault, metavar="KIND:N", help=at)
    made.add_argument("--until", type=float, default=600.0, help="[s] after which it ends")
    return made


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
