"""The emulated device: firmware, joints and line on one clock, with a note of
everything that happens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from stringcast.hardware.emulated.joints import Joint
from stringcast.hardware.emulated.terminal import EmulatedDevice, UnpluggedError
from stringcast.hardware.serial.firmware import Firmware
from stringcast.hardware.serial.protocol import (
    JOINT_COUNT,
    Deframer,
    FrameError,
    FrameKind,
    decode_command,
)

DELAY_S = 0.03  # [s] of a delayed frame: several ticks
REORDER_DELAY_S = 0.0075  # [s] after which the next frame, a tick behind, has arrived
# [s] for which a frozen device reads nothing; its watchdog's timer goes on
FREEZE_S = 0.2
BOOT_S = 0.05  # [s] that a device needs once its supply is back
ANSWER_PREFIX = "answer-"  # of faults on the way back


# what arrives of a frame, and how much later [s]
DelayedPieces = list[tuple[float, bytes]]


def _deliver(frame: bytes) -> DelayedPieces:
    return [(0.0, frame)]


def _flip_bit(frame: bytes) -> DelayedPieces:
    """With another bit in the middle."""
    middle = len(frame) // 2
    return [(0.0, frame[:middle] + bytes([frame[middle] ^ 0x10]) + frame[middle + 1 :])]


LINE_FAULTS: dict[str, Callable[[bytes], DelayedPieces]] = {
    "drop": lambda frame: [],
    "duplicate": lambda frame: [(0.0, frame), (0.0, frame)],
    "corrupt": _flip_bit,
    "delay": lambda frame: [(DELAY_S, frame)],
    "reorder": lambda frame: [(REORDER_DELAY_S, frame)],  # the next one overtakes it
}


class Arrival(NamedTuple):
    """Bytes on their way: when they arrive [s], and the fault that befalls them or
    their answer.
    """

    when: float
    frame: bytes
    fault: str


@dataclass
class EmulatedArm(EmulatedDevice):
    """firmware: what it runs. since: its clock when it starts [us]. booted: when it
    last started [s].
    """

    firmware: Firmware
    initial_clock: int = 0
    joints: list[Joint] = field(
        default_factory=lambda: [Joint() for _ in range(JOINT_COUNT)]
    )
    boot_time: float = 0.0
    incoming: list[Arrival] = field(default_factory=list)
    outgoing: list[Arrival] = field(default_factory=list)
    deframer: Deframer = field(default_factory=Deframer)

    @property
    def micros(self) -> int:
        """The device's clock [us]."""
        return (self.initial_clock + round((self.clock - self.boot_time) * 1e6)) % 2**32

    def receive(self, data: bytes) -> None:
        """Bytes from the host, on their way from now on. Raises UnpluggedError."""
        for frame in self.deframer.frames(data):
            try:
                moves = decode_command(frame).kind is FrameKind.VELOCITY
            except FrameError:
                moves = False
            fault = self.next_fault() if moves else ""
            # one of the device itself strikes at once
            DEVICE_FAULTS.get(fault, lambda device: None)(self)
            self.incoming += self._schedule(
                frame, fault, LINE_FAULTS.get(fault, _deliver)
            )

    def step(self) -> bytes:
        """Timer, joints, and the frames that arrive meanwhile, which are obeyed; the
        bytes that are due to leave.
        """
        self.firmware.tick(self.micros)
        for joint, speed in zip(self.joints, self.firmware.target, strict=True):
            joint.step(speed)
        if self.clock < self.deaf_until:
            return b""
        for _, frame, fault in _pop_due(self.incoming, self.clock):
            answer = self.firmware.answer_frame(
                frame, self.micros, tuple(joint.encoder for joint in self.joints)
            )
            through = (
                LINE_FAULTS[fault.removeprefix(ANSWER_PREFIX)]
                if fault.startswith(ANSWER_PREFIX)
                else _deliver
            )
            self.outgoing += self._schedule(answer, fault, through)
        return b"".join(
            arrival.frame for arrival in _pop_due(self.outgoing, self.clock)
        )

    @property
    def state(self) -> tuple[str, bool]:
        """The firmware's state, and whether the arm stands."""
        return self.firmware.state.name.lower(), all(
            joint.is_still for joint in self.joints
        )

    def restart(self) -> None:
        """The supply broke down for a moment: all that was known is lost, the joints
        stay where they are.
        """
        self.firmware = Firmware(self.firmware.watchdog)
        self.incoming, self.outgoing = [], []
        self.initial_clock, self.boot_time, self.deaf_until = (
            0,
            self.clock,
            self.clock + BOOT_S,
        )

    def _schedule(
        self, frame: bytes, fault: str, through: Callable[[bytes], DelayedPieces]
    ) -> list[Arrival]:
        return [
            Arrival(self.clock + late, piece, fault) for late, piece in through(frame)
        ]


def _pop_due(way: list[Arrival], now: float) -> list[Arrival]:
    """Arrivals due by now, removed from the queue."""
    due = [arrival for arrival in way if arrival.when <= now]
    way[:] = [arrival for arrival in way if arrival.when > now]
    return due


def _freeze(device: EmulatedArm) -> None:
    device.deaf_until = device.clock + FREEZE_S


def _unplug(device: EmulatedArm) -> None:
    raise UnpluggedError


def _jump(device: EmulatedArm) -> None:
    device.joints[0].offset += 0.5


DEVICE_FAULTS: dict[str, Callable[[EmulatedArm], None]] = {
    "freeze": _freeze,
    "unplug": _unplug,
    "brownout": EmulatedArm.restart,
    "jump": _jump,
}
FAULT_KINDS = (
    *LINE_FAULTS,
    *(ANSWER_PREFIX + name for name in LINE_FAULTS),
    *DEVICE_FAULTS,
)
