"""The interface of a link to an arm: velocities out, angles back, over a serial device
or a bus of servos.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm


@dataclass(frozen=True, slots=True)
class ArmAnswer:
    """number: of the command that is answered. clock: device time, unwrapped [s]. held:
    why the device follows no commands, empty if it does. angles: measured when the
    command arrived, (J,) [rad].
    """

    number: int
    clock: float
    hold_reason: str
    angles: tuple[float, ...]


class Wire(Protocol):
    """A connection to an arm. Each method raises `HardwareError` where it cannot do its
    work.
    """

    @property
    def name(self) -> str:
        """The port or device of the arm, for messages."""

    @property
    def watchdog(self) -> float:
        """Time without a command after which the device stops the arm by itself [s]."""

    def open(self) -> None:
        """Connect and agree on how to talk; nothing moves. Refuses a device that was
        latched.
        """

    def set_limits(self, arm: Arm) -> None:
        """Have the device keep to the arm's limits of speed and acceleration by itself;
        raises where it does not.
        """

    def close(self) -> None:
        """Let go. Does nothing where nothing is open."""

    def angles(self) -> tuple[float, ...]:
        """Measured now, by one round trip, (J,) [rad]."""

    def send(self, speeds: np.ndarray) -> tuple[int, np.ndarray]:
        """Send velocities (J,) [rad/s] without waiting; the command's number, and what
        was really sent.
        """

    def answers(self) -> Sequence[ArmAnswer]:
        """The answers that have come since the last call; damaged ones are left out."""

    def stop(self) -> None:
        """Velocity zero, at once. Also where the connection is broken: then it does
        nothing.
        """

    def latch(self) -> None:
        """Emergency stop: velocity zero, and the device follows nothing until `clear`.
        Never raises.
        """

    def clear(self) -> None:
        """Undo `latch` on purpose, after a person has looked at the arm."""


def confirm_and_clear(wire: Wire) -> None:
    """Have a person look at the arm, and then undo its emergency stop; exits with the
    reason where that fails.
    """
    try:
        said = input("Is the arm safe to move, and nobody within its reach? Type yes: ")
    except EOFError:  # nobody is there to look
        said = ""
    if said.strip() != "yes":
        sys.exit("It stays latched.")
    try:
        wire.clear()
    except HardwareError as error:
        sys.exit(f"Error: {error}")
    finally:
        wire.close()
    print("Cleared.")
