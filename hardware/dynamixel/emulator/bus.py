"""Emulated servos in velocity mode, with the registers that a driver uses, on one bus."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from stringcast.hardware.dynamixel.emulator.packets import (
    PING,
    READ,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Packet,
    Splitter,
    status,
)
from stringcast.hardware.dynamixel.registers import (
    ACCELERATION_UNIT,
    BUS_WATCHDOG,
    GOAL_VELOCITY,
    OPERATING_MODE,
    POSITION_UNIT,
    PRESENT_POSITION,
    PROFILE_ACCELERATION,
    REALTIME_TICK,
    TICKS,
    TORQUE_ENABLE,
    TRIPPED,
    VELOCITY_LIMIT,
    VELOCITY_MODE,
    VELOCITY_UNIT,
    WATCHDOG_UNIT,
    Register,
)
from stringcast.hardware.emulated.joints import STEP, Joint
from stringcast.hardware.emulated.terminal import Emulated, UnpluggedError

MODEL = bytes([0xFC, 0x03, 0x2D])  # XM430-W350, firmware 45
NO_ERROR, UNKNOWN, RANGE, LIMIT, ACCESS = 0, 2, 4, 6, 7  # of status packets
GOALS = (100, 120)  # addresses that a tripped watchdog makes read-only
LOCKED = 64  # addresses below are locked while the torque is on


@dataclass
class Servo:
    """A servo. table: its control table. silent: time since the last packet on the bus [s]. speed: which it has the
    joint follow [rad/s]."""

    table: bytearray = field(default_factory=lambda: bytearray(147))
    joint: Joint = field(default_factory=Joint)
    silent: float = 0.0
    speed: float = 0.0

    def __post_init__(self) -> None:
        """Set the factory's values, but for a velocity limit of 60 rad/s."""
        self.set(OPERATING_MODE, 3)
        self.set(VELOCITY_LIMIT, round(60 / VELOCITY_UNIT))
        self.set(PRESENT_POSITION, 2048)

    def get(self, register: Register) -> int:
        """A value, signed if it has four bytes."""
        data = self.table[register.address : register.address + register.size]
        return int.from_bytes(data, "little", signed=register.size == 4)

    def set(self, register: Register, value: int) -> None:
        """Write a register's value, also one that a host may not write."""
        data = value.to_bytes(register.size, "little", signed=value < 0)
        self.table[register.address : register.address + register.size] = data

    def write(self, address: int, data: bytes) -> int:
        """Write as an instruction does. Returns the error of the status packet."""
        if self.get(TORQUE_ENABLE) and address < LOCKED:
            return ACCESS
        if self.get(BUS_WATCHDOG) == TRIPPED and GOALS[0] <= address < GOALS[1]:
            return RANGE
        goal = int.from_bytes(data, "little", signed=True) if address == GOAL_VELOCITY.address else 0
        if abs(goal) > self.get(VELOCITY_LIMIT):
            return LIMIT
        self.table[address : address + len(data)] = data
        return NO_ERROR

    def step(self, clock: float) -> None:
        """One step of time; clock: the servo's own [s]."""
        self.silent += STEP
        watchdog = self.get(BUS_WATCHDOG)
        # 0 is off, and TRIPPED is beyond what can be set
        if self.get(TORQUE_ENABLE) and 0 < watchdog < 128 and self.silent > watchdog * WATCHDOG_UNIT:
            self.set(BUS_WATCHDOG, TRIPPED)
            self.set(GOAL_VELOCITY, 0)
        follows = self.get(TORQUE_ENABLE) and self.get(OPERATING_MODE) == VELOCITY_MODE
        most = self.get(PROFILE_ACCELERATION) * ACCELERATION_UNIT * STEP or math.inf  # of zero, anything
        change = min(max(self.get(GOAL_VELOCITY) * VELOCITY_UNIT - self.speed, -most), most)
        self.speed = self.speed + change if follows else 0.0
        self.joint.step(self.speed)
        self.set(REALTIME_TICK, int(clock * 1e3) % TICKS)
        self.set(PRESENT_POSITION, 2048 + math.floor(self.joint.encoder / POSITION_UNIT + 0.5))


@dataclass
class Bus(Emulated):
    """servos: by id. A goal velocity that is written to all is one command."""

    servos: Mapping[int, Servo]
    splitter: Splitter = field(default_factory=Splitter)
    coming: list[Packet] = field(default_factory=list)

    def hear(self, data: bytes) -> None:
        """Bytes from the host. Raises UnpluggedError."""
        for packet in self.splitter.packets(data):
            moves = packet.instruction == SYNC_WRITE and packet.parameters[0] == GOAL_VELOCITY.address
            fault = self.fault() if moves else ""
            lost = bool(fault) and STRIKES[fault](self)
            if not lost:
                self.coming.append(packet)

    def step(self) -> bytes:
        """Servos, and the status packets that leave meanwhile."""
        for servo in self.servos.values():
            servo.step(self.clock)
        if self.clock < self.deaf:
            return b""
        out = b"".join(self._obey(packet) for packet in self.coming)
        self.coming.clear()
        return out

    @property
    def state(self) -> tuple[str, bool]:
        """Whether a watchdog has tripped, in a word, and whether the arm stands."""
        servos = self.servos.values()
        tripped = any(servo.get(BUS_WATCHDOG) == TRIPPED for servo in servos)
        return "tripped" if tripped else "cleared", all(servo.joint.still for servo in servos)

    def _obey(self, packet: Packet) -> bytes:
        """What the servos answer to an instruction. Address and length begin most of them."""
        for servo in self.servos.values():
            servo.silent = 0.0
        begin, size = (int.from_bytes(packet.parameters[at : at + 2], "little") for at in (0, 2))
        if packet.instruction == SYNC_WRITE:
            for at in range(4, len(packet.parameters), 1 + size):
                if packet.parameters[at] in self.servos:
                    self.servos[packet.parameters[at]].write(begin, packet.parameters[at + 1 : at + 1 + size])
            return b""
        if packet.instruction == SYNC_READ:
            asked = [number for number in packet.parameters[4:] if number in self.servos]
            return b"".join(status(i, NO_ERROR, bytes(self.servos[i].table[begin : begin + size])) for i in asked)
        if packet.id not in self.servos:
            return b""
        servo = self.servos[packet.id]
        if packet.instruction == WRITE:
            return status(packet.id, servo.write(begin, packet.parameters[2:]))
        told = {PING: MODEL, READ: bytes(servo.table[begin : begin + size])}
        if packet.instruction in told:
            return status(packet.id, NO_ERROR, told[packet.instruction])
        return status(packet.id, UNKNOWN)


def _freeze(bus: Bus) -> bool:
    bus.deaf = bus.clock + 0.4
    return False


def _unplug(bus: Bus) -> bool:
    raise UnpluggedError


def _brownout(bus: Bus) -> bool:
    for servo in bus.servos.values():
        kept, servo.table = servo.table, Servo().table
        servo.table[:LOCKED] = kept[:LOCKED]
    return True


# Each says whether the packet is lost.
STRIKES: dict[str, Callable[[Bus], bool]] = {
    "drop": lambda bus: True,
    "freeze": _freeze,
    "unplug": _unplug,
    "brownout": _brownout,
}
