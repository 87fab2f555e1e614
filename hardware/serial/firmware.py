"""The device's side of the link, specified in README.md.

It has no clock, port or joints. `device/stringcast.c` is the same in C; tests send both
the same bytes and compare the answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float
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
NO_LIMITS = (*(0.0,) * (2 * JOINT_COUNT), 0, 0)  # nothing moves before limits are set
MOVING_STATES = (DeviceState.MOVING, DeviceState.CLAMPED)
READY_STATES = (DeviceState.IDLE, *MOVING_STATES)
# ticks of velocity change at full acceleration, as one command may be lost
ACCELERATION_TICKS = 2


@dataclass
class Firmware:
    """The firmware of a device.

    Attributes
    ----------
    watchdog
        The longest accepted watchdog time [ms].
    state
        Its state.
    target : (J,)
        Commanded velocities of the joints [rad/s].
    last_velocity_us
        Device clock at the last obeyed velocity [us].
    last_sequence
        Sequence number that further velocities must exceed.
    limits
        The limits in force, as in `LimitsAnswer`.
    """

    watchdog: int = 25
    state: DeviceState = DeviceState.FRESH
    target: tuple[float, ...] = ZERO_SPEEDS
    last_velocity_us: int = 0
    last_sequence: int = 0
    limits: tuple[float, ...] = NO_LIMITS
    deframer: Deframer = field(default_factory=Deframer)

    def tick(self, micros: int) -> None:
        """Check the watchdog, from a timer interrupt.

        micros: device clock [us], wraps at 2^32.
        """
        silence = (micros - self.last_velocity_us) % 2**32
        watchdog = self.limits[-1] or self.watchdog
        if self.state in MOVING_STATES and silence > watchdog * 1000:
            self._stop(DeviceState.TRIPPED)

    def receive(self, data: bytes, micros: int, angles: Sequence[float]) -> bytes:
        """Process the frames in data and return the answers.

        angles: measured joint angles (J,) [rad].
        """
        answers = b""
        for frame in self.deframer.frames(data):
            answers += self.answer_frame(frame, micros, angles)
        return answers

    def answer_frame(self, frame: bytes, micros: int, angles: Sequence[float]) -> bytes:
        """Process one frame and return the answer; empty for an invalid one."""
        try:
            command = decode_command(frame)
        except FrameError:
            return b""
        self._apply_command(command, micros)
        number = command.sequence
        if command.kind is FrameKind.HELLO:
            facts = PROTOCOL_VERSION, JOINT_COUNT, self.watchdog, self.state
            return encode_answer(Greeting(number, *facts))
        if command.kind is FrameKind.LIMITS:
            return encode_answer(LimitsAnswer(number, self.limits))
        report = Report(number, micros % 2**32, self.state, tuple(angles))
        return encode_answer(report)

    def _apply_command(self, command: Command, micros: int) -> None:
        number, values = command.sequence, command.values
        is_new = is_newer(number, self.last_sequence)
        is_latched = self.state is DeviceState.LATCHED
        is_ready = self.state in READY_STATES
        match command.kind:
            case FrameKind.LATCH:
                self._stop(DeviceState.LATCHED)
            case FrameKind.CLEAR if is_latched:
                self._stop(DeviceState.FRESH)
            case FrameKind.HELLO if not is_latched and values == (PROTOCOL_VERSION,):
                self.last_sequence, self.limits = number, NO_LIMITS
                self._stop(DeviceState.IDLE)
            case FrameKind.LIMITS if self.state is DeviceState.IDLE:
                if min(values) >= 0 and values[-1] > 0:
                    self.limits = (*values[:-1], min(values[-1], self.watchdog))
            case FrameKind.STOP if is_ready:
                if is_new:
                    self.last_sequence = number
                self._stop(DeviceState.IDLE)
            case FrameKind.VELOCITY if is_ready and is_new:
                self._apply_velocity(command, micros)

    def _apply_velocity(self, command: Command, micros: int) -> None:
        """Set a velocity, clamped to the limits.

        After clamping, the state is CLAMPED until the next STOP or HELLO.
        """
        elapsed = 0
        if self.state in MOVING_STATES:
            elapsed = (micros - self.last_velocity_us) % 2**32
        span = max(elapsed, ACCELERATION_TICKS * self.limits[-2]) * 1e-6
        target = []
        for joint in range(JOINT_COUNT):
            speed, acceleration = self.limits[joint], self.limits[JOINT_COUNT + joint]
            wanted, former = command.values[joint], self.target[joint]
            target.append(_limit_velocity(wanted, former, speed, acceleration * span))
        self.target = tuple(target)
        is_cut = self.state is DeviceState.CLAMPED or self.target != command.values
        self.state = DeviceState.CLAMPED if is_cut else DeviceState.MOVING
        self.last_sequence, self.last_velocity_us = command.sequence, micros

    def _stop(self, state: DeviceState) -> None:
        self.state, self.target = state, ZERO_SPEEDS


def _limit_velocity(wanted: float, former: float, speed: float, change: float) -> float:
    """Limit a velocity and its change, in single precision [rad/s]."""
    slow = min(max(wanted, -speed), speed)
    cut = min(max(slow, former - change), former + change)
    return c_float(cut).value
