"""The emulated device: firmware, joints and line on one clock, with a note of everything that happens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from stringcast.hardware.emulated.joints import Joint
from stringcast.hardware.emulated.terminal import Emulated, UnpluggedError
from stringcast.hardware.serial.firmware import Firmware
from stringcast.hardware.serial.protocol import JOINTS, Deframer, FrameError, Kind, decode_command

LATE = 0.03  # [s] of a delayed frame: several ticks
PAST_NEXT = 0.0075  # [s] after which the next frame, a tick behind, has arrived
FREEZE = 0.2  # [s] for which a frozen device reads nothing; its watchdog's timer goes on
BOOT = 0.05  # [s] that a device needs once its supply is back
BACK = "answer-"  # of faults on the way back


Pieces = list[tuple[float, bytes]]  # what arrives of a frame, and how much later [s]


def _whole(frame: bytes) -> Pieces:
    return [(0.0, frame)]


def _flipped(frame: bytes) -> Pieces:
    """With another bit in the middle."""
    middle = len(frame) // 2
    return [(0.0, frame[:middle] + bytes([frame[middle] ^ 0x10]) + frame[middle + 1 :])]


LINE: dict[str, Callable[[bytes], Pieces]] = {
    "drop": lambda frame: [],
    "duplicate": lambda frame: [(0.0, frame), (0.0, frame)],
    "corrupt": _flipped,
    "delay": lambda frame: [(LATE, frame)],
    "reorder": lambda frame: [(PAST_NEXT, frame)],  # the next one overtakes it
}


class Arrival(NamedTuple):
    """Bytes on their way: when they arrive [s], and the fault that befalls them or their answer."""

    when: float
    frame: bytes
    fault: str


@dataclass
class Device(Emulated):
    """firmware: what it runs. since: its clock when it starts [us]. booted: when it last started [s]."""

    firmware: Firmware
    since: int = 0
    joints: list[Joint] = field(default_factory=lambda: [Joint() for _ in range(JOINTS)])
    booted: float = 0.0
    coming: list[Arrival] = field(default_factory=list)
    going: list[Arrival] = field(default_factory=list)
    deframer: Deframer = field(default_factory=Deframer)

    @property
    def micros(self) -> int:
        """The device's clock [us]."""
        return (self.since + round((self.clock - self.booted) * 1e6)) % 2**32

    def hear(self, data: bytes) -> None:
        """Bytes from the host, on their way from now on. Raises UnpluggedError."""
        for frame in self.deframer.frames(data):
            try:
                moves = decode_command(frame).kind is Kind.VELOCITY
            except FrameError:
                moves = False
            fault = self.fault() if moves else ""
            STRIKES.get(fault, lambda device: None)(self)  # one of the device itself strikes at once
            self.coming += self._sent(frame, fault, LINE.get(fault, _whole))

    def step(self) -> bytes:
        """Timer, joints, and the frames that arrive meanwhile, which are obeyed; the bytes that are due to leave."""
        self.firmware.tick(self.micros)
        for joint, speed in zip(self.joints, self.firmware.target, strict=True):
            joint.step(speed)
        if self.clock < self.deaf:
            return b""
        for _, frame, fault in _taken(self.coming, self.clock):
            answer = self.firmware.obey(frame, self.micros, tuple(joint.encoder for joint in self.joints))
            through = LINE[fault.removeprefix(BACK)] if fault.startswith(BACK) else _whole
            self.going += self._sent(answer, fault, through)
        return b"".join(arrival.frame for arrival in _taken(self.going, self.clock))

    @property
    def state(self) -> tuple[str, bool]:
        """The firmware's state, and whether the arm stands."""
        return self.firmware.state.name.lower(), all(joint.still for joint in self.joints)

    def restart(self) -> None:
        """The supply broke down for a moment: all that was known is lost, the joints stay where they are."""
        self.firmware = Firmware(self.firmware.watchdog)
        self.coming, self.going = [], []
        self.since, self.booted, self.deaf = 0, self.clock, self.clock + BOOT

    def _sent(self, frame: bytes, fault: str, through: Callable[[bytes], Pieces]) -> list[Arrival]:
        return [Arrival(self.clock + late, piece, fault) for late, piece in through(frame)]


def _taken(way: list[Arrival], now: float) -> list[Arrival]:
    """Arrivals due by now, removed from the queue."""
    due = [arrival for arrival in way if arrival.when <= now]
    way[:] = [arrival for arrival in way if arrival.when > now]
    return due


def _freeze(device: Device) -> None:
    device.deaf = device.clock + FREEZE


def _unplug(device: Device) -> None:
    raise UnpluggedError


def _jump(device: Device) -> None:
    device.joints[0].offset += 0.5


STRIKES: dict[str, Callable[[Device], None]] = {
    "freeze": _freeze,
    "unplug": _unplug,
    "brownout": Device.restart,
    "jump": _jump,
}
KINDS = (*LINE, *(BACK + name for name in LINE), *STRIKES)
