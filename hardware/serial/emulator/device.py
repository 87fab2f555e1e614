"""The emulated device: firmware, joints and line with one clock."""

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
REORDER_DELAY_S = 0.0075  # [s]: the next frame, a tick later, arrives first
# [s] that a frozen device does not read; its watchdog timer runs on
FREEZE_S = 0.2
BOOT_S = 0.05  # [s] of a restart after a power failure
ANSWER_PREFIX = "answer-"  # faults of answers


# delays [s] and bytes that arrive for a frame
DelayedPieces = list[tuple[float, bytes]]


def _flip_bit(frame: bytes) -> DelayedPieces:
    """Flip a bit in the middle of a frame."""
    middle = len(frame) // 2
    flipped = bytes([frame[middle] ^ 0x10])
    return [(0.0, frame[:middle] + flipped + frame[middle + 1 :])]


LINE_FAULTS: dict[str, Callable[[bytes], DelayedPieces]] = {
    "drop": lambda frame: [],
    "duplicate": lambda frame: [(0.0, frame), (0.0, frame)],
    "corrupt": _flip_bit,
    "delay": lambda frame: [(DELAY_S, frame)],
    "reorder": lambda frame: [(REORDER_DELAY_S, frame)],  # overtaken by the next frame
}


class Arrival(NamedTuple):
    """Bytes in transit: arrival time [s], and the fault of them or of their answer."""

    when: float
    frame: bytes
    fault: str


@dataclass
class EmulatedArm(EmulatedDevice):
    """The emulated device with its arm.

    initial_clock: device clock at the start [us]. boot_time: time of the last start
    [s].
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
        """Receive bytes from the host, sent now.

        Raises UnpluggedError on that fault.
        """
        for frame in self.deframer.frames(data):
            try:
                moves = decode_command(frame).kind is FrameKind.VELOCITY
            except FrameError:
                moves = False
            fault = self.next_fault() if moves else ""
            if fault in DEVICE_FAULTS:  # these act at once
                DEVICE_FAULTS[fault](self)
            self.incoming += self._schedule(frame, fault, fault)

    def step(self) -> bytes:
        """Simulate one step and process the frames that arrive in it.

        Returns the bytes to send.
        """
        self.firmware.tick(self.micros)
        for joint, speed in zip(self.joints, self.firmware.target, strict=True):
            joint.step(speed)
        if self.clock < self.deaf_until:
            return b""
        angles = [joint.encoder for joint in self.joints]
        for _, frame, fault in _pop_due(self.incoming, self.clock):
            answer = self.firmware.answer_frame(frame, self.micros, angles)
            answer_fault = fault.partition(ANSWER_PREFIX)[2]
            self.outgoing += self._schedule(answer, fault, answer_fault)
        return b"".join(due.frame for due in _pop_due(self.outgoing, self.clock))

    @property
    def state(self) -> tuple[str, bool]:
        """The firmware's state, and whether the arm is at rest."""
        stands = all(joint.is_still for joint in self.joints)
        return self.firmware.state.name.lower(), stands

    @property
    def facts(self) -> dict[str, list[float]]:
        """Angles [rad] and speeds [rad/s] of the joints."""
        return {
            "angles": [joint.angle for joint in self.joints],
            "speeds": [joint.speed for joint in self.joints],
        }

    def restart(self) -> None:
        """Restart after a power failure.

        All states are lost; the joints keep their angles.
        """
        self.firmware = Firmware(self.firmware.watchdog)
        self.incoming, self.outgoing = [], []
        self.initial_clock, self.boot_time = 0, self.clock
        self.deaf_until = self.clock + BOOT_S

    def _schedule(self, frame: bytes, fault: str, line_fault: str) -> list[Arrival]:
        """Schedule the arrival of a frame, with the line's fault if any."""
        pieces: DelayedPieces = [(0.0, frame)]
        if line_fault in LINE_FAULTS:
            pieces = LINE_FAULTS[line_fault](frame)
        return [Arrival(self.clock + late, piece, fault) for late, piece in pieces]


def _pop_due(queue: list[Arrival], now: float) -> list[Arrival]:
    """Remove and return the arrivals that are due."""
    due = [arrival for arrival in queue if arrival.when <= now]
    queue[:] = [arrival for arrival in queue if arrival.when > now]
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
