"""A device on a pseudo-terminal, whose name is printed first, and the command that
serves one.
"""

from __future__ import annotations

import argparse
import os
import pty
import select
import signal
import threading
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stringcast.hardware.emulated.joints import STEP_S


class UnpluggedError(Exception):
    """The cable is pulled."""


@dataclass
class EmulatedDevice(ABC):
    """A device on a clock of its own, with a note of everything that happens.

    faults: by number of the velocity command, from 0. note: told of every event. clock:
    true time [s]; owed: time that passed but makes no whole step [s]; deaf: until when
    nothing is read [s]. number: of the next velocity command. seen: `state` when it was
    last looked at.
    """

    faults: Mapping[int, str]
    record_event: Callable[[str, Any], object]
    clock: float = field(default=0.0, init=False)
    unsimulated_s: float = field(default=0.0, init=False)
    deaf_until: float = field(default=0.0, init=False)
    velocity_count: int = field(default=0, init=False)
    last_state: tuple[str, bool] = field(init=False)

    def __post_init__(self) -> None:
        """Only what changes from here on is an event."""
        self.last_state = self.state

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Bytes from the host. Raises UnpluggedError."""

    @abstractmethod
    def step(self) -> bytes:
        """Let one step pass; the bytes that leave meanwhile."""

    @property
    @abstractmethod
    def state(self) -> tuple[str, bool]:
        """What the device says of itself, and whether the arm stands."""

    def advance(self, elapsed: float) -> bytes:
        """Let `elapsed` [s] pass; the bytes that leave meanwhile."""
        out = b""
        self.unsimulated_s += elapsed
        while self.unsimulated_s >= STEP_S:
            self.unsimulated_s -= STEP_S
            self.clock += STEP_S
            out += self.step()
            (before, stood), (now, stands) = self.last_state, self.state
            if now != before:
                self.record_event(now, self)
            if stands is not stood:
                self.record_event("stands" if stands else "moves", self)
            self.last_state = now, stands
        return out

    def next_fault(self) -> str:
        """The fault of the velocity command that just came, which is noted; empty for
        none.
        """
        fault = self.faults.get(self.velocity_count, "")
        self.velocity_count += 1
        if fault:
            self.record_event(fault, self)
        return fault


def command_parser(
    prog: str, description: str | None, kinds: Collection[str]
) -> argparse.ArgumentParser:
    """The parser of an emulator's command: --log, --until, and --fault, a list of
    (number, kind). kinds: of faults.
    """

    def fault(text: str) -> tuple[int, str]:
        kind, _, number = text.partition(":")
        if kind not in kinds:
            raise argparse.ArgumentTypeError(
                f"there is no fault '{kind}'; known are {', '.join(kinds)}"
            )
        return int(number), kind

    made = argparse.ArgumentParser(prog=prog, description=description)
    made.add_argument(
        "--log", type=Path, default=Path(os.devnull), help="events, a line of JSON each"
    )
    at = f"at the N-th velocity command: {', '.join(kinds)}"
    made.add_argument(
        "--fault", action="append", default=[], type=fault, metavar="KIND:N", help=at
    )
    made.add_argument(
        "--until", type=float, default=600.0, help="[s] after which it ends"
    )
    return made


def serve(device: EmulatedDevice, until: float, after: float) -> None:
    """Let the device live for `until` seconds, until SIGTERM, or as long as whoever
    started this. Then, or unplugged, it goes on alone for `after` seconds.
    """
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    with suppress(UnpluggedError):
        _exchange_bytes(device, master, time.monotonic() + until, ended)
    os.close(slave)
    os.close(master)
    device.advance(after)


def _exchange_bytes(
    device: EmulatedDevice, master: int, end: float, ended: threading.Event
) -> None:
    last, parent = time.monotonic(), os.getppid()
    while last < end and os.getppid() == parent and not ended.is_set():
        ready, _, _ = select.select([master], [], [], STEP_S)
        if ready:
            device.receive(os.read(master, 4096))
        now = time.monotonic()
        out = device.advance(now - last)
        last = now
        if out:
            os.write(master, out)
