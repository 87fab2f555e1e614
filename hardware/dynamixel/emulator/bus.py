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
    PacketSplitter,
    status_packet,
)
from stringcast.hardware.dynamixel.registers import (
    ACCELERATION_UNIT,
    BUS_WATCHDOG,
    CLOCK_WRAP_MS,
    GOAL_VELOCITY,
    OPERATING_MODE,
    POSITION_UNIT,
    PRESENT_POSITION,
    PROFILE_ACCELERATION,
    REALTIME_TICK,
    TORQUE_ENABLE,
    VELOCITY_LIMIT,
    VELOCITY_MODE,
    VELOCITY_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT_S,
    Register,
)
from stringcast.hardware.emulated.joints import STEP_S, Joint
from stringcast.hardware.emulated.terminal import EmulatedDevice, UnpluggedError

MODEL_REPLY = bytes([0xFC, 0x03, 0x2D])  # XM430-W350, firmware 45
NO_ERROR, UNKNOWN, RANGE, LIMIT, ACCESS = 0, 2, 4, 6, 7  # of status packets
GOAL_ADDRESSES = (100, 120)  # addresses that a tripped watchdog makes read-only
FIRST_UNLOCKED_ADDRESS = 64  # addresses below are locked while the torque is on


@dataclass
class EmulatedServo:
    """A servo. table: its control table. silent: time since the last packet on the bus
    [s]. speed: which it has the joint follow [rad/s].
    """

    table: bytearray = field(default_factory=lambda: bytearray(147))
    joint: Joint = field(default_factory=Joint)
    silence: float = 0.0
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
        if self.get(TORQUE_ENABLE) and address < FIRST_UNLOCKED_ADDRESS:
            return ACCESS
        if (
            self.get(BUS_WATCHDOG) == WATCHDOG_TRIPPED
            and GOAL_ADDRESSES[0] <= address < GOAL_ADDRESSES[1]
        ):
            return RANGE
        goal = (
            int.from_bytes(data, "little", signed=True)
            if address == GOAL_VELOCITY.address
            else 0
        )
        if abs(goal) > self.get(VELOCITY_LIMIT):
            return LIMIT
        self.table[address : address + len(data)] = data
        return NO_ERROR

    def step(self, clock: float) -> None:
        """One step of time; clock: the servo's own [s]."""
        self.silence += STEP_S
        watchdog = self.get(BUS_WATCHDOG)
        # 0 is off, and TRIPPED is beyond what can be set
        if (
            self.get(TORQUE_ENABLE)
            and 0 < watchdog < 128
            and self.silence > watchdog * WATCHDOG_UNIT_S
        ):
            self.set(BUS_WATCHDOG, WATCHDOG_TRIPPED)
            self.set(GOAL_VELOCITY, 0)
        follows = self.get(TORQUE_ENABLE) and self.get(OPERATING_MODE) == VELOCITY_MODE
        # of zero, anything
        most = self.get(PROFILE_ACCELERATION) * ACCELERATION_UNIT * STEP_S or math.inf
        change = min(
            max(self.get(GOAL_VELOCITY) * VELOCITY_UNIT - self.speed, -most), most
        )
        self.speed = self.speed + change if follows else 0.0
        self.joint.step(self.speed)
        self.set(REALTIME_TICK, int(clock * 1e3) % CLOCK_WRAP_MS)
        self.set(
            PRESENT_POSITION,
            2048 + math.floor(self.joint.encoder / POSITION_UNIT + 0.5),
        )


@dataclass
class EmulatedBus(EmulatedDevice):
    """servos: by id. A goal velocity that is written to all is one command."""

    servos: Mapping[int, EmulatedServo]
    splitter: PacketSplitter = field(default_factory=PacketSplitter)
    incoming: list[Packet] = field(default_factory=list)

    def receive(self, data: bytes) -> None:
        """Bytes from the host. Raises UnpluggedError."""
        for packet in self.splitter.packets(data):
            moves = (
                packet.instruction == SYNC_WRITE
                and packet.parameters[0] == GOAL_VELOCITY.address
            )
            fault = self.next_fault() if moves else ""
            lost = bool(fault) and FAULTS[fault](self)
            if not lost:
                self.incoming.append(packet)

    def step(self) -> bytes:
        """Servos, and the status packets that leave meanwhile."""
        for servo in self.servos.values():
            servo.step(self.clock)
        if self.clock < self.deaf_until:
            return b""
        out = b"".join(self._answer(packet) for packet in self.incoming)
        self.incoming.clear()
        return out

    @property
    def state(self) -> tuple[str, bool]:
        """Whether a watchdog has tripped, in a word, and whether the arm stands."""
        servos = self.servos.values()
        tripped = any(servo.get(BUS_WATCHDOG) == WATCHDOG_TRIPPED for servo in servos)
        return "tripped" if tripped else "cleared", all(
            servo.joint.is_still for servo in servos
        )

    def _answer(self, packet: Packet) -> bytes:
        """What the servos answer to an instruction. Address and length begin most of
        them.
        """
        for servo in self.servos.values():
            servo.silence = 0.0
        begin, size = (
            int.from_bytes(packet.parameters[at : at + 2], "little") for at in (0, 2)
        )
        if packet.instruction == SYNC_WRITE:
            for at in range(4, len(packet.parameters), 1 + size):
                if packet.parameters[at] in self.servos:
                    self.servos[packet.parameters[at]].write(
                        begin, packet.parameters[at + 1 : at + 1 + size]
                    )
            return b""
        if packet.instruction == SYNC_READ:
            asked = [
                number for number in packet.parameters[4:] if number in self.servos
            ]
            return b"".join(
                status_packet(
                    i, NO_ERROR, bytes(self.servos[i].table[begin : begin + size])
                )
                for i in asked
            )
        if packet.id not in self.servos:
            return b""
        servo = self.servos[packet.id]
        if packet.instruction == WRITE:
            return status_packet(packet.id, servo.write(begin, packet.parameters[2:]))
        told = {PING: MODEL_REPLY, READ: bytes(servo.table[begin : begin + size])}
        if packet.instruction in told:
            return status_packet(packet.id, NO_ERROR, told[packet.instruction])
        return status_packet(packet.id, UNKNOWN)


def _freeze(bus: EmulatedBus) -> bool:
    bus.deaf_until = bus.clock + 0.4
    return False


def _unplug(bus: EmulatedBus) -> bool:
    raise UnpluggedError


def _brownout(bus: EmulatedBus) -> bool:
    for servo in bus.servos.values():
        kept, servo.table = servo.table, EmulatedServo().table
        servo.table[:FIRST_UNLOCKED_ADDRESS] = kept[:FIRST_UNLOCKED_ADDRESS]
    return True


# Each says whether the packet is lost.
FAULTS: dict[str, Callable[[EmulatedBus], bool]] = {
    "drop": lambda bus: True,
    "freeze": _freeze,
    "unplug": _unplug,
    "brownout": _brownout,
}
