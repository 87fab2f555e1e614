"""The device's side of the link, as README.md specifies it: no clock, no port, no joints of its own.

`device/stringcast.c` is the same in C; tests feed both the same bytes and expect the same answers.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

from stringcast.hardware.serial.protocol import (
    JOINTS,
    VERSION,
    Command,
    Deframer,
    FrameError,
    Greeting,
    Kind,
    Limits,
    Report,
    State,
    decode_command,
    encode_answer,
    newer,
)

REST = (0.0,) * JOINTS
NONE = (*(0.0,) * (2 * JOINTS), 0, 0)  # no limits were set: nothing moves
FOLLOWING = (State.MOVING, State.CLAMPED)
OBEYING = (State.IDLE, *FOLLOWING)
BEFORE = 2  # ticks over which a velocity may change at full acceleration: one command may be lost or overtaken


@dataclass
class Firmware:
    """target: velocity that the joints' loops are to follow [rad/s]. watchdog: the longest that it bears [ms]; heard:
    device clock [us] of the last velocity that was obeyed; last: its sequence number. limits: in force, as `Limits`."""

    watchdog: int = 25
    state: State = State.FRESH
    target: tuple[float, ...] = REST
    heard: int = 0
    last: int = 0
    limits: tuple[float, ...] = NONE
    deframer: Deframer = field(default_factory=Deframer)

    def tick(self, micros: int) -> None:
        """The watchdog, from a timer that nothing can hold up. micros: device clock [us], wraps at 2^32."""
        if self.state in FOLLOWING and (micros - self.heard) % 2**32 > (self.limits[-1] or self.watchdog) * 1000:
            self._rest(State.TRIPPED)

    def receive(self, data: bytes, micros: int, angles: Sequence[float]) -> bytes:
        """Act on what has come, and say what to answer. angles: measured now (J,) [rad]."""
        return b"".join(self.obey(frame, micros, angles) for frame in self.deframer.frames(data))

    def obey(self, frame: bytes, micros: int, angles: Sequence[float]) -> bytes:
        """One frame: act on it and answer; nothing for what is no whole command."""
        try:
            command = decode_command(frame)
        except FrameError:
            return b""
        self._act(command, micros)
        if command.kind is Kind.HELLO:
            return encode_answer(Greeting(command.sequence, VERSION, JOINTS, self.watchdog, self.state))
        if command.kind is Kind.LIMITS:
            return encode_answer(Limits(command.sequence, self.limits))
        return encode_answer(Report(command.sequence, micros % 2**32, self.state, tuple(angles)))

    def _act(self, command: Command, micros: int) -> None:
        match command.kind:
            case Kind.LATCH:
                self._rest(State.LATCHED)
            case Kind.CLEAR if self.state is State.LATCHED:
                self._rest(State.FRESH)
            case Kind.HELLO if self.state is not State.LATCHED and command.values == (VERSION,):
                self.last, self.limits = command.sequence, NONE
                self._rest(State.IDLE)
            case Kind.LIMITS if self.state is State.IDLE and min(command.values) >= 0 and command.values[-1] > 0:
                self.limits = (*command.values[:-1], min(command.values[-1], self.watchdog))
            case Kind.STOP if self.state in OBEYING:
                self.last = command.sequence if newer(command.sequence, self.last) else self.last
                self._rest(State.IDLE)
            case Kind.VELOCITY if self.state in OBEYING and newer(command.sequence, self.last):
                self._follow(command, micros)

    def _follow(self, command: Command, micros: int) -> None:
        """Take over a velocity, cut to the limits, and say so until the next STOP or HELLO if it had to be."""
        elapsed = (micros - self.heard) % 2**32 if self.state in FOLLOWING else 0
        span = max(elapsed, BEFORE * self.limits[-2]) * 1e-6
        limits = zip(command.values, self.target, self.limits[:JOINTS], self.limits[JOINTS:], strict=False)
        target = tuple(_within(wanted, was, speed, rate * span) for wanted, was, speed, rate in limits)
        clamped = self.state is State.CLAMPED or target != command.values
        self.state, self.target = State.CLAMPED if clamped else State.MOVING, target
        self.last, self.heard = command.sequence, micros

    def _rest(self, state: State) -> None:
        self.state, self.target = state, REST


def _within(wanted: float, was: float, speed: float, change: float) -> float:
    """A velocity that is at most `speed`, and at most `change` from what it was, in single precision [rad/s]."""
    slow = min(max(wanted, -speed), speed)
    cut = min(max(slow, was - change), was + change)
    return float(struct.unpack("<f", struct.pack("<f", cut))[0])
