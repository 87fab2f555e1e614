"""The host's side of the bus: velocities by sync write, angles by sync read, the
servos' own bus watchdog.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Annotated, Any, Literal

import numpy as np
import serial
from pydantic import Field

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

try:  # what a pulled cable raises in pyserial, beside its own error
    import termios

    LINK_ERRORS: tuple[type[Exception], ...] = (
        serial.SerialException,
        OSError,
        termios.error,
    )
except ImportError:
    LINK_ERRORS = (serial.SerialException, OSError)

# of a packet before the bus counts as dead: a disturbed line loses single ones
MAX_TRIES = 3
# [s] that a read sleeps for bytes; the library would spin, and keep a core from
# everybody else
READ_BLOCK_S = 0.001


@dataclass(frozen=True)
class ServoSettings:
    """One joint. zero: position [counts of 2 pi / 4096] at joint angle zero; direction:
    of the joint's angle.
    """

    id: Annotated[int, Field(ge=0, le=252)]
    zero: int
    direction: Literal[-1, 1]


@dataclass
class DynamixelBus:
    """Fills `hardware.arm.wire.Wire`.

    servos: base first. fastest: what each must be able to do [rad/s]. reply: time [s]
    that an answer may take. patience: multiples of 20 ms without a command after which
    each servo stops by itself. owed: velocity that rounding has left out so far (J,)
    [rad/s]; it is made up for in the next command, so that rounding to 0.024 rad/s does
    not add up to a way. most: of each servo's velocity (J,) [counts]; zero until
    `limit`.
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
    sdk: Any = None
    handler: Any = None
    packets: Any = None
    reader: Any = None
    writer: Any = None

    @property
    def name(self) -> str:
        """The port."""
        return self.port

    @property
    def watchdog(self) -> float:
        """The watchdog time of every servo [s]."""
        return self.patience * WATCHDOG_UNIT_S

    def open(self) -> None:
        """Connect, find every servo well, and put it into velocity mode; nothing moves."""
        self._connect()
        for servo, limit in zip(self.servos, self.required_speeds, strict=True):
            self._check_servo(servo, limit)
        self._make_ready()

    def set_limits(self, arm: Arm) -> None:
        """Each servo's own limits, read back; its velocity limit, which outlasts the
        power, is only ever lowered.
        """
        most = [math.ceil(speed / VELOCITY_UNIT) for speed in arm.speed]
        for servo, count, acceleration in zip(
            self.servos, most, arm.acceleration, strict=True
        ):
            # the velocity limit can be changed only so
            self._write(servo, TORQUE_ENABLE, 0)
            self._set_and_verify(servo, VELOCITY_LIMIT, count)
            self._set_and_verify(
                servo, PROFILE_ACCELERATION, math.ceil(acceleration / ACCELERATION_UNIT)
            )
            self._write(servo, TORQUE_ENABLE, 1)
        self.max_counts = np.array(most)

    def close(self) -> None:
        """Torque off, and let go."""
        if self.handler is None:
            return
        try:
            for _ in range(MAX_TRIES):
                self._write_all(TORQUE_ENABLE, 0)
        except HardwareError:
            pass  # nobody is there: the bus watchdog has acted
        if self.handler.ser is not None:
            self.handler.closePort()
        self.handler = None

    def angles(self) -> tuple[float, ...]:
        """Angles of the joints (J,) [rad], by a sync read."""
        for _ in range(MAX_TRIES):
            states = self._read_all()
            if states:
                return self._angles(states)
        raise HardwareError(
            f"arm on {self.port}: the servos do not answer. Check their supply and the bus."
        )

    def send(self, speeds: np.ndarray) -> tuple[int, np.ndarray]:
        """Send velocities (J,) [rad/s], in units of 0.229 rpm; the first arms the
        watchdogs. The command's number, and what was sent.
        """
        if not self.watchdogs_armed:
            self._write_all(BUS_WATCHDOG, self.patience)
            self.watchdogs_armed, self.rounding_debt = True, np.zeros(len(self.servos))
        wanted = speeds + self.rounding_debt
        # else it is not obeyed
        counts = np.clip(
            np.rint(wanted / VELOCITY_UNIT).astype(int),
            -self.max_counts,
            self.max_counts,
        )
        carried = counts * VELOCITY_UNIT
        self.rounding_debt = np.clip(
            wanted - carried, -VELOCITY_UNIT / 2, VELOCITY_UNIT / 2
        )  # what a limit cut is not made up for
        for servo, count in zip(self.servos, counts, strict=True):
            self.writer.changeParam(
                servo.id,
                list(int(servo.direction * count).to_bytes(4, "little", signed=True)),
            )
        self._call(self.writer.txPacket)
        self.command_number, self.answer_pending = self.command_number + 1, True
        return self.command_number, carried

    def answers(self) -> Sequence[ArmAnswer]:
        """Positions of the servos, asked once after each velocity."""
        if not self.answer_pending:
            return []
        self.answer_pending = False
        states = self._read_all()
        if not states:
            return []
        # the first servo's clock, unwrapped: it goes round every 33 seconds
        millis = register_value(states[0], REALTIME_TICK)
        self.clock_ms = (
            millis
            if self.clock_ms is None
            else self.clock_ms + (millis - self.clock_ms) % CLOCK_WRAP_MS
        )
        return [
            ArmAnswer(
                self.command_number,
                self.clock_ms * 1e-3,
                self._hold_reason(states),
                self._angles(states),
            )
        ]

    def stop(self) -> None:
        """Velocity zero, then the watchdogs that we armed may rest; one that has acted
        stays as it is.
        """
        try:
            for _ in range(MAX_TRIES):
                self._write_all(GOAL_VELOCITY, 0)
            self._hold_reason(self._read_all())
            if self.watchdogs_armed and not self.latched:
                self._write_all(BUS_WATCHDOG, 0)
        except HardwareError:
            return  # nobody is there: the watchdogs act
        self.watchdogs_armed = False

    def latch(self) -> None:
        """Velocity zero, then silence until the servos' watchdogs have tripped: that is
        their own latch.
        """
        self.latched = True
        try:
            for _ in range(MAX_TRIES):
                self._write_all(GOAL_VELOCITY, 0)
            self._write_all(BUS_WATCHDOG, 1)
        except HardwareError:
            return
        time.sleep(3 * WATCHDOG_UNIT_S)

    def clear(self) -> None:
        """Undo tripped watchdogs; connects where nothing is open."""
        if self.handler is None:
            self._connect()
        self._make_ready()
        self.latched = self.watchdogs_armed = False

    def _make_ready(self) -> None:
        """Velocity mode at velocity zero, torque on, watchdogs at rest."""
        for servo in self.servos:
            self._write(servo, TORQUE_ENABLE, 0)  # the mode can be changed only so
            self._set_and_verify(servo, OPERATING_MODE, VELOCITY_MODE)
            # first: a tripped one makes the goal read-only
            self._write(servo, BUS_WATCHDOG, 0)
            self._write(servo, GOAL_VELOCITY, 0)
            self._write(servo, TORQUE_ENABLE, 1)

    def _connect(self) -> None:
        check_latency(self.port)
        try:
            self.sdk = import_module("dynamixel_sdk")
        except ModuleNotFoundError as error:
            raise HardwareError(
                "hardware=dynamixel needs the maker's library: pip install dynamixel-sdk"
            ) from error
        self.handler = self.sdk.PortHandler(self.port)
        # The library waits for 34 ms at least, seven ticks.
        self.handler.setPacketTimeout = lambda length: (
            self.handler.setPacketTimeoutMillis(self.reply * 1e3)
        )
        self.packets = self.sdk.PacketHandler(2.0)
        try:
            opened, why = (
                self.handler.setBaudRate(self.baud),
                f"the library knows no rate of {self.baud} baud",
            )
        except LINK_ERRORS as error:
            opened, why = False, str(error)
        if not opened:
            raise HardwareError(
                f"arm on {self.port}: cannot be opened ({why}). Check hardware.port and the cable."
            )
        self.handler.ser.timeout = READ_BLOCK_S
        self.reader = self.sdk.GroupSyncRead(self.handler, self.packets, *STATE_BLOCK)
        self.writer = self.sdk.GroupSyncWrite(
            self.handler, self.packets, *GOAL_VELOCITY
        )
        for servo in self.servos:
            self.reader.addParam(servo.id)
            self.writer.addParam(servo.id, [0, 0, 0, 0])

    def _check_servo(self, servo: ServoSettings, speed: float) -> None:
        """Refuse a servo that is latched, ill or too slow. speed: what the arm's limits
        ask of it [rad/s].
        """
        place = f"arm on {self.port}: servo {servo.id}"
        if self._read(servo, BUS_WATCHDOG) == WATCHDOG_TRIPPED:
            self.latched = True
            raise HardwareError(
                f"{place} was latched by an emergency stop or its watchdog. Look why, make it safe, then: python -m "
                f"stringcast.hardware.dynamixel.clear {self.port} {' '.join(str(s.id) for s in self.servos)}"
            )
        ill = self._read(servo, HARDWARE_ERROR)
        if ill:
            raise HardwareError(
                f"{place} reports hardware error {ill:#04x}. See its manual, then reboot it."
            )
        if self._read(servo, DRIVE_MODE) & TIME_BASED_PROFILE:
            raise HardwareError(
                f"{place} takes accelerations as times (Drive Mode, register {DRIVE_MODE.address}, bit 2), so that it "
                "would keep no limit of its own. Set a velocity-based profile with the maker's wizard."
            )
        limit = self._read(servo, VELOCITY_LIMIT) * VELOCITY_UNIT
        if limit < speed:
            raise HardwareError(
                f"{place} turns at {limit:.2f} rad/s at most (its Velocity Limit, register {VELOCITY_LIMIT.address}), "
                f"arm.speed is {speed:.2f}. Lower that, or raise the servo's limit with the maker's wizard."
            )

    def _read(self, servo: ServoSettings, register: Register) -> int:
        def ask() -> tuple[Any, int, int]:
            return self.packets.readTxRx(self.handler, servo.id, *register)

        return int.from_bytes(bytes(self._exchange(servo, ask)), "little")

    def _write(self, servo: ServoSettings, register: Register, value: int) -> None:
        data = list(value.to_bytes(register.size, "little"))
        self._exchange(
            servo,
            lambda: (
                None,
                *self.packets.writeTxRx(self.handler, servo.id, *register, data),
            ),
        )

    def _set_and_verify(
        self, servo: ServoSettings, register: Register, value: int
    ) -> None:
        """Have a register hold a value, and see that it does: a servo may acknowledge
        what it does not take.
        """
        if self._read(servo, register) != value:
            self._write(servo, register, value)
        held = self._read(servo, register)
        if held != value:
            raise HardwareError(
                f"arm on {self.port}: servo {servo.id} holds {held} in register {register.address} where {value} was "
                "asked for; nothing was moved. Look at its control table with the maker's wizard, or reset the servo."
            )

    def _exchange(self, servo: ServoSettings, ask: Any) -> Any:
        """An exchange with one servo; asks again a few times, for a packet may be lost.
        Raises HardwareError.
        """
        why = ""
        for _ in range(MAX_TRIES):
            data, result, error = self._call(ask)
            # the top bit: see HARDWARE_ERROR
            if result == self.sdk.COMM_SUCCESS and error & 0x7F == 0:
                return data
            why = self.packets.getRxPacketError(
                error & 0x7F
            ) or self.packets.getTxRxResult(result)
        raise HardwareError(
            f"arm on {self.port}: servo {servo.id}: {why} Check its id, supply and baud rate."
        )

    def _write_all(self, register: Register, value: int) -> None:
        """To every servo in one packet, which nobody answers."""
        data = value.to_bytes(register.size, "little")
        flat = [byte for servo in self.servos for byte in (servo.id, *data)]
        self._call(
            lambda: self.packets.syncWriteTxOnly(
                self.handler, *register, flat, len(flat)
            )
        )

    def _read_all(self) -> list[bytes]:
        """The registers STATE of all servos; empty where one did not answer."""
        if self._call(self.reader.txRxPacket) != self.sdk.COMM_SUCCESS:
            return []
        return [bytes(self.reader.data_dict[servo.id]) for servo in self.servos]

    def _call(self, act: Any) -> Any:
        """The result of a call of the library. Raises HardwareError for a broken
        connection.
        """
        if self.handler is None or not self.handler.is_open:
            raise HardwareError(f"arm on {self.port}: it is not open.")
        try:
            return act()
        except LINK_ERRORS as error:
            raise HardwareError(
                f"arm on {self.port}: the link is gone ({error}). The servos' bus watchdogs stop the arm."
            ) from error
        finally:
            # the library leaves it set where it was interrupted
            self.handler.is_using = False

    def _hold_reason(self, states: Sequence[bytes]) -> str:
        """Why a servo follows no commands, which its watchdog betrays; empty if all do."""
        watchdogs = {register_value(state, BUS_WATCHDOG) for state in states}
        if WATCHDOG_TRIPPED in watchdogs:
            self.latched = True
            return "a servo's bus watchdog stopped it"
        return "" if watchdogs == {self.patience} else "a servo restarted"

    def _angles(self, states: Sequence[bytes]) -> tuple[float, ...]:
        return tuple(
            servo.direction
            * (register_value(state, PRESENT_POSITION) - servo.zero)
            * POSITION_UNIT
            for servo, state in zip(self.servos, states, strict=True)
        )
