"""The device's side of the link, as README.md specifies it: no clock, no port, no
joints of its own.

`device/stringcast.c` is the same in C; tests feed both the same bytes and expect the
same answers.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

from stringcast.hardware.serial.protocol import (
    JOINT_COUNT,
    PROTOCOL_VERSION,
    Command,
    Deframer,
    DeviceState,
    FrameError,
    FrameKind,
    Greeting,
    LimitsAnswer,
    Report,
    decode_command,
    encode_answer,
    is_newer,
)

ZERO_SPEEDS = (0.0,) * JOINT_COUNT
NO_LIMITS = (*(0.0,) * (2 * JOINT_COUNT), 0, 0)  # no limits were set: nothing moves
MOVING_STATES = (DeviceState.MOVING, DeviceState.CLAMPED)
READY_STATES = (DeviceState.IDLE, *MOVING_STATES)
# ticks over which a velocity may change at full acceleration: one command may be lost
# or overtaken
ACCELERATION_TICKS = 2


@dataclass
class Firmware:
    """target: velocity that the joints' loops are to follow [rad/s]. watchdog: the
    longest that it bears [ms]; heard: device clock [us] of the last velocity that was
    obeyed; last: its sequence number. limits: in force, as `Limits`.
    """

    watchdog: int = 25
    state: DeviceState = DeviceState.FRESH
    target: tuple[float, ...] = ZERO_SPEEDS
    last_velocity_us: int = 0
    last_sequence: int = 0
    limits: tuple[float, ...] = NO_LIMITS
    deframer: Deframer = field(default_factory=Deframer)

    def tick(self, micros: int) -> None:
        """The watchdog, from a timer that nothing can hold up. micros: device clock
        [us], wraps at 2^32.
        """
        if (
            self.state in MOVING_STATES
            and (micros - self.last_velocity_us) % 2**32
            > (self.limits[-1] or self.watchdog) * 1000
        ):
            self._stop(DeviceState.TRIPPED)

    def receive(self, data: bytes, micros: int, angles: Sequence[float]) -> bytes:
        """Act on what has come, and say what to answer. angles: measured now (J,)
        [rad].
        """
        return b"".join(
            self.answer_frame(frame, micros, angles)
            for frame in self.deframer.frames(data)
        )

    def answer_frame(self, frame: bytes, micros: int, angles: Sequence[float]) -> bytes:
        """One frame: act on it and answer; nothing for what is no whole command."""
        try:
            command = decode_command(frame)
        except FrameError:
            return b""
        self._apply_command(command, micros)
        if command.kind is FrameKind.HELLO:
            return encode_answer(
                Greeting(
                    command.sequence,
                    PROTOCOL_VERSION,
                    JOINT_COUNT,
                    self.watchdog,
                    self.state,
                )
            )
        if command.kind is FrameKind.LIMITS:
            return encode_answer(LimitsAnswer(command.sequence, self.limits))
        return encode_answer(
            Report(command.sequence, micros % 2**32, self.state, tuple(angles))
        )

    def _apply_command(self, command: Command, micros: int) -> None:
        match command.kind:
            case FrameKind.LATCH:
                self._stop(DeviceState.LATCHED)
            case FrameKind.CLEAR if self.state is DeviceState.LATCHED:
                self._stop(DeviceState.FRESH)
            case FrameKind.HELLO if (
                self.state is not DeviceState.LATCHED
                and command.values == (PROTOCOL_VERSION,)
            ):
                self.last_sequence, self.limits = command.sequence, NO_LIMITS
                self._stop(DeviceState.IDLE)
            case FrameKind.LIMITS if (
                self.state is DeviceState.IDLE
                and min(command.values) >= 0
                and command.values[-1] > 0
            ):
                self.limits = (
                    *command.values[:-1],
                    min(command.values[-1], self.watchdog),
                )
            case FrameKind.STOP if self.state in READY_STATES:
                self.last_sequence = (
                    command.sequence
                    if is_newer(command.sequence, self.last_sequence)
                    else self.last_sequence
                )
                self._stop(DeviceState.IDLE)
            case FrameKind.VELOCITY if self.state in READY_STATES and is_newer(
                command.sequence, self.last_sequence
            ):
                self._apply_velocity(command, micros)

    def _apply_velocity(self, command: Command, micros: int) -> None:
        """Take over a velocity, cut to the limits, and say so until the next STOP or
        HELLO if it had to be.
        """
        elapsed = (
            (micros - self.last_velocity_us) % 2**32
            if self.state in MOVING_STATES
            else 0
        )
        span = max(elapsed, ACCELERATION_TICKS * self.limits[-2]) * 1e-6
        limits = zip(
            command.values,
            self.target,
            self.limits[:JOINT_COUNT],
            self.limits[JOINT_COUNT:],
            strict=False,
        )
        target = tuple(
            _limit_velocity(wanted, was, speed, rate * span)
            for wanted, was, speed, rate in limits
        )
        clamped = self.state is DeviceState.CLAMPED or target != command.values
        self.state, self.target = (
            DeviceState.CLAMPED if clamped else DeviceState.MOVING,
            target,
        )
        self.last_sequence, self.last_velocity_us = command.sequence, micros

    def _stop(self, state: DeviceState) -> None:
        self.state, self.target = state, ZERO_SPEEDS


def _limit_velocity(wanted: float, was: float, speed: float, change: float) -> float:
    """A velocity that is at most `speed`, and at most `change` from what it was, in
    single precision [rad/s].
    """
    slow = min(max(wanted, -speed), speed)
    cut = min(max(slow, was - change), was + change)
    return float(struct.unpack("<f", struct.pack("<f", cut))[0])
