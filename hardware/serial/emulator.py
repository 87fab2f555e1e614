"""A device on a pseudo-terminal: reference behaviour, arm dynamics, watchdog, and faults on request."""

from __future__ import annotations

import argparse
import json
import os
import pty
import select
import time
import tty
from dataclasses import dataclass, field
from pathlib import Path

from hardware.serial.protocol import JOINTS, STOP, VELOCITY, Answer, FrameError, decode_command, encode_answer

WATCHDOG = 0.025  # [s]
LAG = 0.004  # [s] time constant of the velocity loop
STEP = 0.0005  # [s]
DELAY = 0.03  # [s] by which a delayed answer comes late
FREEZE = 0.2  # [s] for which a frozen device neither listens nor moves on


@dataclass(frozen=True)
class Fault:
    """What goes wrong with the frame of a number, counted from 0 over velocity commands."""

    kind: str
    frame: int


@dataclass
class Device:
    """The firmware: what it is told, where its joints are, and when it stops by itself."""

    started: float = field(default_factory=time.monotonic)
    target: list[float] = field(default_factory=lambda: [0.0] * JOINTS)
    speed: list[float] = field(default_factory=lambda: [0.0] * JOINTS)
    angle: list[float] = field(default_factory=lambda: [0.0] * JOINTS)
    heard: float = 0.0
    stopped: bool = True
    clock: float = 0.0

    def advance(self) -> None:
        """Let the joints follow up to now; the watchdog acts at its own time."""
        now = time.monotonic() - self.started
        while self.clock < now:
            self.clock += STEP
            if self.clock - self.heard > WATCHDOG:
                self.stop()
            for j in range(JOINTS):
                self.speed[j] += (self.target[j] - self.speed[j]) * STEP / LAG
                self.angle[j] += self.speed[j] * STEP

    def stop(self) -> None:
        """Zero velocity."""
        self.target, self.stopped = [0.0] * JOINTS, True

    def command(self, speeds: tuple[float, ...]) -> None:
        """A velocity command."""
        self.target, self.stopped, self.heard = list(speeds), False, self.clock

    def state(self) -> dict[str, object]:
        """For the log."""
        return {
            "clock": self.clock,
            "angle": self.angle,
            "speed": self.speed,
            "target": self.target,
            "stopped": self.stopped,
        }


class UnpluggedError(Exception):
    """The cable is pulled."""


def serve(master: int, log: Path, faults: list[Fault], until: float) -> None:
    """Answer frames until `until` seconds have passed or the cable is pulled; the log ends with the last state."""
    device, buffer, number = Device(), b"", 0
    due: list[tuple[float, bytes]] = []
    end = time.monotonic() + until
    while time.monotonic() < end:
        ready, _, _ = select.select([master], [], [], STEP)
        device.advance()
        if ready:
            try:
                buffer += os.read(master, 4096)
            except OSError:  # nobody holds the other side
                time.sleep(STEP)
        *frames, buffer = buffer.split(b"\0")
        for frame in frames:
            number, answers = _handle(device, frame, number, faults)
            due += answers
        for _, data in [d for d in due if d[0] <= time.monotonic()]:
            os.write(master, data)
        due = [d for d in due if d[0] > time.monotonic()]
        _note(log, device)


def _handle(device: Device, frame: bytes, number: int, faults: list[Fault]) -> tuple[int, list[tuple[float, bytes]]]:
    """One frame: act on it, and say what to answer when."""
    try:
        command = decode_command(frame)
    except FrameError:
        return number, []
    kinds = {f.kind for f in faults if f.frame == number and command.kind == VELOCITY}
    number += command.kind == VELOCITY
    if "unplug" in kinds:
        raise UnpluggedError
    if "freeze" in kinds:
        time.sleep(FREEZE)
        device.advance()
    if "jump" in kinds:
        device.angle[0] += 0.3
    if "drop" in kinds:
        return number, []
    if command.kind == VELOCITY:
        device.command(command.speeds)
    elif command.kind == STOP:
        device.stop()
    answer = encode_answer(Answer(command.sequence, device.clock, device.stopped, tuple(device.angle)))
    if "corrupt" in kinds:
        answer = bytes([answer[0], answer[1] ^ 0x55]) + answer[2:]
    now = time.monotonic() + (DELAY if "delay" in kinds else 0)
    return number, [(now, answer)] * (2 if "duplicate" in kinds else 1)


def _note(log: Path, device: Device) -> None:
    """The state now, replaced as a whole."""
    aside = log.with_suffix(".part")
    aside.write_text(json.dumps(device.state()))
    os.replace(aside, log)


def main() -> None:
    """Print the pseudo-terminal's name and serve it; after unplugging, go on until the arm rests."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--fault", action="append", default=[], metavar="KIND:FRAME")
    parser.add_argument("--until", type=float, default=60.0)
    options = parser.parse_args()
    faults = [Fault(kind, int(frame)) for kind, frame in (text.split(":") for text in options.fault)]
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    try:
        serve(master, options.log, faults, options.until)
    except UnpluggedError:
        os.close(slave)
        os.close(master)


if __name__ == "__main__":
    main()
