"""Emulated servos in velocity mode on one bus, with the registers of the driver."""

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
GOAL_ADDRESSES = (100, 120)  # read-only while the watchdog is tripped
FIRST_UNLOCKED_ADDRESS = 64  # lower addresses are locked while torque is on


@dataclass
class EmulatedServo:
    """The registers and the joint of an emulated servo.

    table: control table. silence: time since the last packet on the bus [s]. speed:
    velocity command of the joint [rad/s].
    """

    table: bytearray = field(default_factory=lambda: bytearray(147))
    joint: Joint = field(default_factory=Joint)
    silence: float = 0.0
    speed: float = 0.0

    def __post_init__(self) -> None:
        """Set factory values, with a velocity limit of 60 rad/s."""
        self.set(OPERATING_MODE, 3)
        self.set(VELOCITY_LIMIT, round(60 / VELOCITY_UNIT))
        self.set(PRESENT_POSITION, 2048)

    def get(self, register: Register) -> int:
        """Read a register; four bytes are signed."""
        data = self.table[register.address : register.address + register.size]
        return int.from_bytes(data, "little", signed=register.size == 4)

    def set(self, register: Register, value: int) -> None:
        """Write a register without the restrictions for hosts."""
        data = value.to_bytes(register.size, "little", signed=value < 0)
        self.table[register.address : register.address + register.size] = data

    def write(self, address: int, data: bytes) -> int:
        """Write as a host; return the error of the status packet."""
        if self.get(TORQUE_ENABLE) and address < FIRST_UNLOCKED_ADDRESS:
            return ACCESS
        if (
            self.get(BUS_WATCHDOG) == WATCHDOG_TRIPPED
            and GOAL_ADDRESSES[0] <= address < GOAL_ADDRESSES[1]
        ):
            return RANGE
        if address == GOAL_VELOCITY.address:
            goal = int.from_bytes(data, "little", signed=True)
            if abs(goal) > self.get(VELOCITY_LIMIT):
                return LIMIT
        self.table[address : address + len(data)] = data
        return NO_ERROR

    def step(self, clock: float) -> None:
        """Simulate one step; `clock` is the servo's clock [s]."""
        self.silence += STEP_S
        watchdog = self.get(BUS_WATCHDOG)
        # 0: off; TRIPPED exceeds all valid settings
        has_torque = self.get(TORQUE_ENABLE)
        is_late = self.silence > watchdog * WATCHDOG_UNIT_S
        if has_torque and 0 < watchdog < 128 and is_late:
            self.set(BUS_WATCHDOG, WATCHDOG_TRIPPED)
            self.set(GOAL_VELOCITY, 0)
        # zero acceleration means no limit
        limit = self.get(PROFILE_ACCELERATION) * ACCELERATION_UNIT * STEP_S or math.inf
        change = self.get(GOAL_VELOCITY) * VELOCITY_UNIT - self.speed
        self.speed += min(max(change, -limit), limit)
        if not has_torque or self.get(OPERATING_MODE) != VELOCITY_MODE:
            self.speed = 0.0
        self.joint.step(self.speed)
        self.set(REALTIME_TICK, int(clock * 1e3) % CLOCK_WRAP_MS)
        counts = math.floor(self.joint.encoder / POSITION_UNIT + 0.5)
        self.set(PRESENT_POSITION, 2048 + counts)


@dataclass
class EmulatedBus(EmulatedDevice):
    """A bus of servos by id; a sync write of velocities counts as one command."""

    servos: Mapping[int, EmulatedServo]
    splitter: PacketSplitter = field(default_factory=PacketSplitter)
    incoming: list[Packet] = field(default_factory=list)

    def receive(self, data: bytes) -> None:
        """Receive bytes from the host; raise UnpluggedError on that fault."""
        for packet in self.splitter.packets(data):
            is_write = packet.instruction == SYNC_WRITE
            is_velocity = is_write and packet.parameters[0] == GOAL_VELOCITY.address
            fault = self.next_fault() if is_velocity else ""
            is_lost = fault and FAULTS[fault](self)
            if not is_lost:
                self.incoming.append(packet)

    def step(self) -> bytes:
        """Simulate one step; return the status packets sent in it."""
        for servo in self.servos.values():
            servo.step(self.clock)
        if self.clock < self.deaf_until:
            return b""
        out = b"".join(self._answer(packet) for packet in self.incoming)
        self.incoming.clear()
        return out

    @property
    def state(self) -> tuple[str, bool]:
        """The state of the watchdogs, and whether the arm is at rest."""
        word, stands = "cleared", True
        for servo in self.servos.values():
            if servo.get(BUS_WATCHDOG) == WATCHDOG_TRIPPED:
                word = "tripped"
            stands = stands and servo.joint.is_still
        return word, stands

    @property
    def facts(self) -> dict[str, list[float]]:
        """Joint angles [rad], and whether the torque is on."""
        servos = self.servos.values()
        return {
            "angles": [servo.joint.angle for servo in servos],
            "torque": [servo.get(TORQUE_ENABLE) for servo in servos],
        }

    def _answer(self, packet: Packet) -> bytes:
        """Answer an instruction; most begin with address and length."""
        for servo in self.servos.values():
            servo.silence = 0.0
        instruction, parameters = packet.instruction, packet.parameters
        start = int.from_bytes(parameters[0:2], "little")
        size = int.from_bytes(parameters[2:4], "little")
        block = slice(start, start + size)
        if instruction == SYNC_WRITE:
            self._write_servos(start, size, parameters[4:])
            return b""
        if instruction == SYNC_READ:
            return self._read_servos(block, parameters[4:])
        if packet.id not in self.servos:
            return b""
        servo = self.servos[packet.id]
        if instruction == WRITE:
            return status_packet(packet.id, servo.write(start, parameters[2:]))
        replies = {PING: MODEL_REPLY, READ: bytes(servo.table[block])}
        if instruction in replies:
            return status_packet(packet.id, NO_ERROR, replies[instruction])
        return status_packet(packet.id, UNKNOWN)

    def _write_servos(self, start: int, size: int, content: bytes) -> None:
        """Write to several servos; content: id and `size` bytes for each."""
        for place in range(0, len(content), 1 + size):
            number, data = content[place], content[place + 1 : place + 1 + size]
            if number in self.servos:
                self.servos[number].write(start, data)

    def _read_servos(self, block: slice, numbers: bytes) -> bytes:
        """Return status packets of several servos with a block of registers."""
        answer = b""
        for number in numbers:
            if number in self.servos:
                data = bytes(self.servos[number].table[block])
                answer += status_packet(number, NO_ERROR, data)
        return answer


def _freeze(bus: EmulatedBus) -> bool:
    bus.deaf_until = bus.clock + 0.4
    return False


def _unplug(bus: EmulatedBus) -> bool:
    raise UnpluggedError


def _brownout(bus: EmulatedBus) -> bool:
    for servo in bus.servos.values():
        # registers that survive power-off
        stored = servo.table[:FIRST_UNLOCKED_ADDRESS]
        servo.table = EmulatedServo().table
        servo.table[:FIRST_UNLOCKED_ADDRESS] = stored
    return True


# each returns whether the packet is lost
FAULTS: dict[str, Callable[[EmulatedBus], bool]] = {
    "drop": lambda bus: True,
    "freeze": _freeze,
    "unplug": _unplug,
    "brownout": _brownout,
}
