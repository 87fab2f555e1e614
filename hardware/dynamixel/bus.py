"""The host's side of a bus of servos.

Sync write sends velocities, sync read returns angles. The servos' bus watchdogs stop
the arm.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stringcast.data.lazy_module import LazyModule
from stringcast.hardware.arm.wire import ArmAnswer
from stringcast.hardware.dynamixel.registers import (
    ACCELERATION_UNIT,
    BUS_WATCHDOG,
    CLOCK_WRAP_MS,
    DRIVE_MODE,
    GOAL_VELOCITY,
    HARDWARE_ERROR,
    OPERATING_MODE,
    POSITION_UNIT,
    PRESENT_POSITION,
    PROFILE_ACCELERATION,
    REALTIME_TICK,
    STATE_BLOCK,
    TIME_BASED_PROFILE,
    TORQUE_ENABLE,
    VELOCITY_LIMIT,
    VELOCITY_MODE,
    VELOCITY_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT_S,
    Register,
    register_value,
)
from stringcast.hardware.serial.wire import check_latency
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm

dynamixel_sdk = LazyModule("dynamixel_sdk")
serial = LazyModule("serial")

# repetitions of a packet, as a disturbed line loses single ones
MAX_TRIES = 3
# [s] of sleep of a read; the library would busy-wait
READ_BLOCK_S = 0.001


def link_errors() -> tuple[type[Exception], ...]:
    """Return the error types of a pulled cable."""
    errors: tuple[type[Exception], ...] = (serial.SerialException, OSError)
    try:
        import termios
    except ImportError:  # Windows
        return errors
    return (*errors, termios.error)


@dataclass(frozen=True)
class ServoSettings:
    """The servo of one joint.

    Attributes
    ----------
    id
        Its id on the bus.
    zero
        Its position at joint angle zero [counts of 2 pi / 4096].
    direction
        Sign of the joint's angle.
    """

    id: Annotated[int, Field(ge=0, le=252)]
    zero: int
    direction: Literal[-1, 1]


@dataclass
class DynamixelBus:
    """A bus of servos; implements `hardware.arm.wire.Wire`.

    Attributes
    ----------
    servos
        The servos, base first.
    required_speeds
        Speed that each servo must reach [rad/s].
    reply
        Timeout of an answer [s].
    patience
        Multiples of 20 ms without a command after which each servo stops by itself.
    rounding_debt : (J,)
        Accumulated rounding error [rad/s]. The next command compensates it, so that
        rounding to 0.024 rad/s does not add up to a displacement.
    max_counts : (J,)
        Largest velocity of each servo [counts]; zero until `set_limits`.
    """

    port: str
    baud: int
    servos: Sequence[ServoSettings]
    required_speeds: Sequence[float]
    reply: float
    patience: int
    command_number: int = 0
    answer_pending: bool = False
    watchdogs_armed: bool = False
    latched: bool = False
    clock_ms: int | None = None
    rounding_debt: np.ndarray = field(default_factory=lambda: np.zeros(0))
    max_counts: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=int))
    handler: Any = None
    packets: Any = None
    reader: Any = None
    writer: Any = None

    @property
    def watchdog(self) -> float:
        """The watchdog time of every servo [s]."""
        return self.patience * WATCHDOG_UNIT_S

    def open(self) -> None:
        """Connect, check every servo, and put it into velocity mode; nothing moves."""
        self._connect()
        for servo, speed in zip(self.servos, self.required_speeds, strict=True):
            self._check_servo(servo, speed)
        self._make_ready()

    def set_limits(self, arm: Arm) -> None:
        """Set each servo's own limits and read them back.

        The velocity limit survives power-off and is only ever lowered.
        """
        max_counts = []
        for servo, speed, acceleration in zip(
            self.servos, arm.speed, arm.acceleration, strict=True
        ):
            max_counts.append(math.ceil(speed / VELOCITY_UNIT))
            acceleration_counts = math.ceil(acceleration / ACCELERATION_UNIT)
            # writable only with torque off
            self._write(servo, TORQUE_ENABLE, 0)
            self._set_and_verify(servo, VELOCITY_LIMIT, max_counts[-1])
            self._set_and_verify(servo, PROFILE_ACCELERATION, acceleration_counts)
            self._write(servo, TORQUE_ENABLE, 1)
        self.max_counts = np.array(max_counts)

    def close(self) -> None:
        """Switch the torque off and close the port."""
        if self.handler is None:
            return
        with suppress(HardwareError):  # no servo answers: the bus watchdog has tripped
            for _ in range(MAX_TRIES):
                self._write_all(TORQUE_ENABLE, 0)
        if self.handler.ser is not None:
            self.handler.closePort()
        self.handler = None

    def angles(self) -> tuple[float, ...]:
        """Measure the joint angles (J,) [rad] by a sync read."""
        for _ in range(MAX_TRIES):
            states = self._read_all()
            if states:
                return self._angles(states)
        raise HardwareError(
            f"arm on {self.port}",
            "the servos do not answer",
            "Check their supply and the bus.",
        )

    def send(self, speeds: np.ndarray) -> tuple[int, np.ndarray]:
        """Send velocities (J,) [rad/s], in units of 0.229 rpm.

        The first command arms the watchdogs. Returns number and sent velocities of the
        command.
        """
        if not self.watchdogs_armed:
            self._write_all(BUS_WATCHDOG, self.patience)
            self.watchdogs_armed, self.rounding_debt = True, np.zeros(len(self.servos))
        wanted = speeds + self.rounding_debt
        counts = np.rint(wanted / VELOCITY_UNIT).astype(int)
        # a servo ignores velocities beyond its limit
        counts = np.clip(counts, -self.max_counts, self.max_counts)
        sent = counts * VELOCITY_UNIT
        # do not compensate what a limit cut off
        half = VELOCITY_UNIT / 2
        self.rounding_debt = np.clip(wanted - sent, -half, half)
        for servo, count in zip(self.servos, counts, strict=True):
            goal = int(servo.direction * count).to_bytes(4, "little", signed=True)
            self.writer.changeParam(servo.id, list(goal))
        self._call(self.writer.txPacket)
        self.command_number, self.answer_pending = self.command_number + 1, True
        return self.command_number, sent

    def answers(self) -> Sequence[ArmAnswer]:
        """Read the positions of the servos, once per velocity command."""
        if not self.answer_pending:
            return []
        self.answer_pending = False
        states = self._read_all()
        if not states:
            return []
        # the first servo's clock, unwrapped: it wraps every 33 seconds
        millis = register_value(states[0], REALTIME_TICK)
        last = millis if self.clock_ms is None else self.clock_ms
        self.clock_ms = last + (millis - last) % CLOCK_WRAP_MS
        clock = self.clock_ms * 1e-3
        self._note_tripped_watchdogs(states)
        hold_reason, angles = self._hold_reason(states), self._angles(states)
        return [ArmAnswer(self.command_number, clock, hold_reason, angles)]

    def stop(self) -> None:
        """Set velocity zero, then disarm the watchdogs that were armed here.

        Tripped ones stay tripped.
        """
        with suppress(HardwareError):  # no servo answers: the watchdogs trip
            for _ in range(MAX_TRIES):
                self._write_all(GOAL_VELOCITY, 0)
            self._note_tripped_watchdogs(self._read_all())
            if self.watchdogs_armed and not self.latched:
                self._write_all(BUS_WATCHDOG, 0)
            self.watchdogs_armed = False

    def latch(self) -> None:
        """Set velocity zero, then wait until the servos' watchdogs have tripped.

        A tripped watchdog latches the servo.
        """
        self.latched = True
        with suppress(HardwareError):
            for _ in range(MAX_TRIES):
                self._write_all(GOAL_VELOCITY, 0)
            self._write_all(BUS_WATCHDOG, 1)
            time.sleep(3 * WATCHDOG_UNIT_S)

    def clear(self) -> None:
        """Clear tripped watchdogs; connect first if the bus is not open."""
        if self.handler is None:
            self._connect()
        self._make_ready()
        self.latched = self.watchdogs_armed = False

    def _make_ready(self) -> None:
        """Set velocity mode at velocity zero, torque on, watchdogs off."""
        for servo in self.servos:
            # writable only with torque off
            self._write(servo, TORQUE_ENABLE, 0)
            self._set_and_verify(servo, OPERATING_MODE, VELOCITY_MODE)
            # first: a tripped watchdog makes the goal read-only
            self._write(servo, BUS_WATCHDOG, 0)
            self._write(servo, GOAL_VELOCITY, 0)
            self._write(servo, TORQUE_ENABLE, 1)

    def _connect(self) -> None:
        check_latency(self.port)
        self.handler = dynamixel_sdk.PortHandler(self.port)
        # The library waits at least 34 ms, seven ticks.
        self.handler.setPacketTimeout = lambda length: (
            self.handler.setPacketTimeoutMillis(self.reply * 1e3)
        )
        self.packets = dynamixel_sdk.PacketHandler(2.0)
        fault = f"the library knows no rate of {self.baud} baud"
        try:
            is_open = self.handler.setBaudRate(self.baud)
        except link_errors() as error:
            is_open, fault = False, str(error)
        if not is_open:
            raise HardwareError(
                f"arm on {self.port}",
                f"cannot be opened ({fault})",
                "Check hardware.port and the cable.",
            )
        self.handler.ser.timeout = READ_BLOCK_S
        self.reader = dynamixel_sdk.GroupSyncRead(
            self.handler, self.packets, *STATE_BLOCK
        )
        self.writer = dynamixel_sdk.GroupSyncWrite(
            self.handler, self.packets, *GOAL_VELOCITY
        )
        for servo in self.servos:
            self.reader.addParam(servo.id)
            self.writer.addParam(servo.id, [0, 0, 0, 0])

    def _check_servo(self, servo: ServoSettings, speed: float) -> None:
        """Refuse a servo that is latched, faulty or slower than `speed` [rad/s]."""
        place = f"arm on {self.port}: servo {servo.id}"
        if self._read(servo, BUS_WATCHDOG) == WATCHDOG_TRIPPED:
            self.latched = True
            ids = " ".join(str(one.id) for one in self.servos)
            raise HardwareError(
                "",
                f"{place} was latched by an emergency stop or its watchdog",
                "Look why, make it safe, then: python -m "
                f"stringcast.hardware.dynamixel.clear {self.port} {ids}",
            )
        fault = self._read(servo, HARDWARE_ERROR)
        if fault:
            raise HardwareError(
                "",
                f"{place} reports hardware error {fault:#04x}",
                "See its manual, then reboot it.",
            )
        if self._read(servo, DRIVE_MODE) & TIME_BASED_PROFILE:
            raise HardwareError(
                "",
                f"{place} takes accelerations as times (Drive Mode, register "
                f"{DRIVE_MODE.address}, bit 2), so that it would keep no limit "
                "of its own",
                "Set a velocity-based profile with the maker's wizard.",
            )
        limit = self._read(servo, VELOCITY_LIMIT) * VELOCITY_UNIT
        if limit < speed:
            raise HardwareError(
                "",
                f"{place} turns at {limit:.2f} rad/s at most (its Velocity "
                f"Limit, register {VELOCITY_LIMIT.address}), arm.speed is "
                f"{speed:.2f}",
                "Lower that, or raise the servo's limit with the maker's wizard.",
            )

    def _read(self, servo: ServoSettings, register: Register) -> int:
        (data,) = self._exchange(servo, self.packets.readTxRx, *register)
        return int.from_bytes(bytes(data), "little")

    def _write(self, servo: ServoSettings, register: Register, value: int) -> None:
        data = list(value.to_bytes(register.size, "little"))
        self._exchange(servo, self.packets.writeTxRx, *register, data)

    def _set_and_verify(
        self, servo: ServoSettings, register: Register, value: int
    ) -> None:
        """Set a register and read it back.

        A servo may acknowledge a value without storing it.
        """
        if self._read(servo, register) != value:
            self._write(servo, register, value)
        actual = self._read(servo, register)
        if actual != value:
            raise HardwareError(
                f"arm on {self.port}",
                f"servo {servo.id} holds {actual} in register {register.address} "
                f"where {value} was asked for; nothing was moved",
                "Look at its control table with the maker's wizard, or reset "
                "the servo.",
            )

    def _exchange(
        self, servo: ServoSettings, act: Callable[..., Any], *details: Any
    ) -> Any:
        """Exchange packets with one servo; repeat if one is lost.

        Returns the result of the library's method `act` without its two error codes.
        Raises HardwareError if the servo does not answer or reports an error.
        """
        fault = ""
        for _ in range(MAX_TRIES):
            *data, result, error = self._call(act, self.handler, servo.id, *details)
            error &= 0x7F  # ignore the top bit: see HARDWARE_ERROR
            if result == dynamixel_sdk.COMM_SUCCESS and error == 0:
                return data
            fault = self.packets.getRxPacketError(error)
            fault = fault or self.packets.getTxRxResult(result)
        raise HardwareError(
            f"arm on {self.port}",
            f"servo {servo.id}: {fault} Check its id, supply and baud rate",
        )

    def _write_all(self, register: Register, value: int) -> None:
        """Write a register of every servo in one packet without an answer."""
        data: list[int] = []
        for servo in self.servos:
            data += servo.id, *value.to_bytes(register.size, "little")
        # looked up after the call has checked that the bus is open
        self._call(
            lambda: self.packets.syncWriteTxOnly(
                self.handler, *register, data, len(data)
            )
        )

    def _read_all(self) -> list[bytes]:
        """Read the registers STATE_BLOCK of all servos; empty if one is silent."""
        if self._call(self.reader.txRxPacket) != dynamixel_sdk.COMM_SUCCESS:
            return []
        return [bytes(self.reader.data_dict[servo.id]) for servo in self.servos]

    def _call(self, act: Callable[..., Any], *arguments: Any) -> Any:
        """Call the library; raise HardwareError for a broken connection."""
        if self.handler is None or not self.handler.is_open:
            raise HardwareError(f"arm on {self.port}", "it is not open")
        try:
            return act(*arguments)
        except link_errors() as error:
            raise HardwareError(
                f"arm on {self.port}",
                f"the link is gone ({error})",
                "The servos' bus watchdogs stop the arm.",
            ) from error
        finally:
            # the library does not reset this after an interruption
            self.handler.is_using = False

    def _note_tripped_watchdogs(self, states: Sequence[bytes]) -> None:
        """Record a latched bus if a servo's watchdog has tripped."""
        if WATCHDOG_TRIPPED in _watchdog_values(states):
            self.latched = True

    def _hold_reason(self, states: Sequence[bytes]) -> str:
        """Return why a servo ignores commands; empty if none does."""
        watchdogs = _watchdog_values(states)
        if WATCHDOG_TRIPPED in watchdogs:
            return "a servo's bus watchdog stopped it"
        return "" if watchdogs == {self.patience} else "a servo restarted"

    def _angles(self, states: Sequence[bytes]) -> tuple[float, ...]:
        angles = []
        for servo, state in zip(self.servos, states, strict=True):
            counts = register_value(state, PRESENT_POSITION) - servo.zero
            angles.append(servo.direction * counts * POSITION_UNIT)
        return tuple(angles)


def _watchdog_values(states: Sequence[bytes]) -> set[int]:
    """Return the watchdog values of the servos."""
    return {register_value(state, BUS_WATCHDOG) for state in states}
