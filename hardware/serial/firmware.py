"""The device's side of the link, as README.md specifies it: no clock, no port, no joints of its own.

`device/stringcast.c` is the same in C; tests feed both the same bytes and expect the same answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from hardware.serial.protocol import (
    JOINTS,
    VERSION,
    Command,
    Deframer,
    FrameError,
    Greeting,
    Kind,
    Report,
    State,
    decode_command,
    encode_answer,
    newer,
)

REST = (0.0,) * JOINTS


@dataclass
class Firmware:
    """target: velocity that the joints' loops are to follow [rad/s]. watchdog [ms]; heard: device clock [us] of
    the last velocity that was obeyed; last: its sequence number."""

    watchdog: int = 25
    state: State = State.FRESH
    target: tuple[float, ...] = REST
    heard: int = 0
    last: int = 0
    deframer: Deframer = field(default_factory=Deframer)

    def tick(self, micros: int) -> None:
        """The watchdog, from a timer that nothing can hold up. micros: device clock [us], wraps at 2^32."""
        if self.state is State.MOVING and (micros - self.heard) % 2**32 > self.watchdog * 1000:
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
        return encode_answer(Report(command.sequence, micros % 2**32, self.state, tuple(angles)))

    def _act(self, command: Command, micros: int) -> None:
        match command.kind:
            case Kind.LATCH:
                self._rest(State.LATCHED)
            case Kind.CLEAR if self.state is State.LATCHED:
                self._rest(State.FRESH)
            case Kind.HELLO if self.state is not State.LATCHED and command.values == (VERSION,):
                self.last = command.sequence
                self._rest(State.IDLE)
            case Kind.STOP if self.state in (State.IDLE, State.MOVING):
                self.last = command.sequence if newer(command.sequence, self.last) else self.last
                self._rest(State.IDLE)
            case Kind.VELOCITY if self.state in (State.IDLE, State.MOVING) and newer(command.sequence, self.last):
                self.last, self.heard = command.sequence, micros
                self.state, self.target = State.MOVING, command.values

    def _rest(self, state: State) -> None:
        self.state, self.target = state, REST
