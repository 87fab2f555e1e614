"""A device on a pseudo-terminal, and the command that serves one."""

from __future__ import annotations

import argparse
import json
import os
import pty
import select
import signal
import threading
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from stringcast.hardware.emulated.joints import STEP_S


class UnpluggedError(Exception):
    """The cable was pulled."""


@dataclass
class EmulatedDevice(ABC):
    """A device with its own clock and a record of its events.

    Attributes
    ----------
    faults
        Faults by number of the velocity command.
    log
        File for the events, one line of JSON each.
    clock
        True time [s].
    unsimulated_s
        Remainder of time below one step [s].
    deaf_until
        Time until which nothing is read [s].
    velocity_count
        Number of the next velocity command.
    last_state
        The last value of `state`.
    """

    faults: Mapping[int, str]
    log: TextIO
    clock: float = field(default=0.0, init=False)
    unsimulated_s: float = field(default=0.0, init=False)
    deaf_until: float = field(default=0.0, init=False)
    velocity_count: int = field(default=0, init=False)
    last_state: tuple[str, bool] = field(init=False)

    def __post_init__(self) -> None:
        """Store the first state, which is not an event."""
        self.last_state = self.state

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Receive bytes from the host; raise UnpluggedError on that fault."""

    @abstractmethod
    def step(self) -> bytes:
        """Simulate one step; return the bytes sent in it."""

    @property
    @abstractmethod
    def state(self) -> tuple[str, bool]:
        """The device's state, and whether the arm is at rest."""

    @property
    @abstractmethod
    def facts(self) -> dict[str, list[float]]:
        """Numbers of each joint, recorded with every event."""

    def record_event(self, event: str) -> None:
        """Record an event with the time [s], the state and the facts."""
        row = {"event": event, "t": self.clock, "state": self.state[0], **self.facts}
        self.log.write(json.dumps(row) + "\n")

    def advance(self, elapsed: float) -> bytes:
        """Simulate `elapsed` [s]; return the bytes sent in it."""
        out = b""
        self.unsimulated_s += elapsed
        while self.unsimulated_s >= STEP_S:
            self.unsimulated_s -= STEP_S
            self.clock += STEP_S
            out += self.step()
            word, stands = self.state
            last_word, stood = self.last_state
            if word != last_word:
                self.record_event(word)
            if stands is not stood:
                self.record_event("stands" if stands else "moves")
            self.last_state = word, stands
        return out

    def next_fault(self) -> str:
        """Record and return the fault of a velocity command; empty for none."""
        fault = self.faults.get(self.velocity_count, "")
        self.velocity_count += 1
        if fault:
            self.record_event(fault)
        return fault


def command_parser(
    prog: str, description: str | None, kinds: Collection[str]
) -> argparse.ArgumentParser:
    """Make the parser of an emulator's command.

    Its options are --log, --until, and --fault, a list of (number, kind).
    """

    def fault(text: str) -> tuple[int, str]:
        kind, _, number = text.partition(":")
        if kind not in kinds:
            raise argparse.ArgumentTypeError(
                f"there is no fault '{kind}'; known are {', '.join(kinds)}"
            )
        return int(number), kind

    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument(
        "--log", type=Path, default=Path(os.devnull), help="events, a line of JSON each"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        type=fault,
        metavar="KIND:N",
        help=f"at the N-th velocity command: {', '.join(kinds)}",
    )
    parser.add_argument(
        "--until", type=float, default=600.0, help="[s] after which it ends"
    )
    return parser


def serve(device: EmulatedDevice, duration: float, after: float) -> None:
    """Serve a device for `duration` seconds, or until SIGTERM or its parent's end.

    Afterwards, or unplugged, it runs on alone for `after` seconds.
    """
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    with suppress(UnpluggedError):
        _exchange_bytes(device, master, time.monotonic() + duration, ended)
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
