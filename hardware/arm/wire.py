"""The interface of a link to an arm: velocities out, angles back."""

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
    """The arm's answer to a command.

    Attributes
    ----------
    number
        Number of the command.
    clock
        Device time, unwrapped [s].
    hold_reason
        Why the device ignores commands; empty if it does not.
    angles : (J,)
        Joint angles measured when the command arrived [rad].
    """

    number: int
    clock: float
    hold_reason: str
    angles: tuple[float, ...]


class Wire(Protocol):
    """A link to an arm, over a serial device or a bus of servos.

    Each method raises `HardwareError` on failure.

    Attributes
    ----------
    port
        The device file of the link.
    """

    port: str

    @property
    def watchdog(self) -> float:
        """Time without commands after which the device stops by itself [s]."""

    def open(self) -> None:
        """Connect and agree on the protocol; nothing moves.

        Raises
        ------
        HardwareError
            If the device is missing, of another version, or latched.
        """

    def set_limits(self, arm: Arm) -> None:
        """Make the device enforce the arm's limits of speed and acceleration.

        Raises
        ------
        HardwareError
            If the device does not accept them.
        """

    def close(self) -> None:
        """Close the link; do nothing if it is not open."""

    def angles(self) -> tuple[float, ...]:
        """Measure the joint angles now, by one round trip.

        Returns
        -------
        (J,) tuple of float
            Joint angles [rad].
        """

    def send(self, speeds: np.ndarray) -> tuple[int, np.ndarray]:
        """Send velocities without waiting for an answer.

        Parameters
        ----------
        speeds : (J,)
            Velocities of the joints [rad/s].

        Returns
        -------
        number : int
            The command's number.
        speeds : (J,)
            Sent velocities after rounding [rad/s].
        """

    def answers(self) -> Sequence[ArmAnswer]:
        """Return the answers since the last call, without damaged ones."""

    def stop(self) -> None:
        """Stop the arm at once; do nothing if the connection is broken."""

    def latch(self) -> None:
        """Stop the arm and latch the device until `clear`; never raise."""

    def clear(self) -> None:
        """Undo `latch` after a person has checked the arm."""


def confirm_and_clear(wire: Wire) -> None:
    """Ask a person to check the arm, then clear its emergency stop.

    Exits with the reason on failure.
    """
    try:
        answer = input(
            "Is the arm safe to move, and nobody within its reach? Type yes: "
        )
    except EOFError:  # no person at the terminal
        answer = ""
    if answer.strip() != "yes":
        sys.exit("It stays latched.")
    try:
        wire.clear()
    except HardwareError as error:
        sys.exit(f"Error: {error}")
    finally:
        wire.close()
    print("Cleared.")
