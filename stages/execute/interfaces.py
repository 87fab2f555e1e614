"""Interfaces of the devices in a lab: an arm that follows velocities, and a camera.

`stages.execute` uses the hardware only through them. A device that cannot execute a
command raises `HardwareError`, if possible before anything moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
import pandas as pd

from stringcast.data.errors import ExpectedError


class HardwareError(ExpectedError):
    """A fault of a device; the message names the device, the fault and the remedy."""


@dataclass(frozen=True)
class Performance:
    """The record of one motion by an arm; tables as in `data.artifacts`.

    Parameters
    ----------
    arm : table ARM
        Measured joint angles.
    ticks : table TICKS
        Commands as they were sent.
    link : table LINK
        State of the link, in one row.
    started_at : float
        Host time (time.monotonic) at which the first command was due [s].
    """

    arm: pd.DataFrame
    ticks: pd.DataFrame
    link: pd.DataFrame
    started_at: float


@dataclass(frozen=True)
class Recording:
    """The frames of one motion.

    Late and lost frames are reported in `counts` and `summary`.

    Parameters
    ----------
    t : (F,) array
        Mid-exposure times on the camera's clock [s], 0 at the start of the movement.
    images : sequence of F uint8 arrays (height, width)
        The frames.
    counts : pandas.DataFrame
        Optional columns of table FRAMES, with a row for each frame.
    summary : mapping
        Optional columns of table LINK, for all frames together.
    fault : str
        Reason why the recording is invalid; empty if it is valid.
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    counts: pd.DataFrame = field(default_factory=pd.DataFrame)
    summary: Mapping[str, Any] = field(default_factory=dict)
    fault: str = ""


class ArmDevice(Protocol):
    """An arm that follows joint velocities.

    It is a context manager: entering opens and checks the link, and leaving always
    stops the arm.
    """

    def __enter__(self) -> Self:
        """Open the arm and check its link."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the arm and close its link."""

    def angles(self) -> np.ndarray:
        """Measure the joint angles.

        Returns
        -------
        (J,) array
            Present angles [rad].

        Raises
        ------
        HardwareError
            If the arm does not answer.
        """

    def check(self, commands: pd.DataFrame) -> None:
        """Refuse commands that leave a limit of the arm; nothing moves.

        Parameters
        ----------
        commands : table COMMANDS
            A row for each tick: t [s], angles q1..q3 [rad], velocities w1..w3 [rad/s].

        Raises
        ------
        HardwareError
            If a limit is left anywhere.
        """

    def move_to(self, angles: Sequence[float]) -> None:
        """Move slowly to joint angles and wait until the string has settled.

        Parameters
        ----------
        angles : sequence of J floats
            Joint angles [rad].

        Raises
        ------
        HardwareError
            If the arm cannot reach them.
        """

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Perform commands tick by tick; afterwards the arm rests.

        Parameters
        ----------
        commands : table COMMANDS
            A row for each tick: t [s], angles q1..q3 [rad], velocities w1..w3 [rad/s].

        Returns
        -------
        Performance
            Measured angles and the commands as sent.

        Raises
        ------
        HardwareError
            If the arm cannot perform them.
        """


class CameraDevice(Protocol):
    """A camera that films in the background between `start` and `stop`.

    It is a context manager: entering opens the camera, and leaving closes it.
    """

    def __enter__(self) -> Self:
        """Open the camera."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the camera."""

    def start(self) -> None:
        """Start to record frames in the background.

        Raises
        ------
        HardwareError
            If no frame arrives.
        """

    def stop(self, moved_at: float) -> Recording:
        """End filming once the last frames have arrived.

        Parameters
        ----------
        moved_at : float
            Host time (time.monotonic) of the start of the movement [s].

        Returns
        -------
        Recording
            Frames with times from the start of the movement.

        Raises
        ------
        HardwareError
            If the camera fails.
        """


@dataclass(frozen=True)
class Lab:
    """An arm and the camera that watches it.

    Parameters
    ----------
    arm : ArmDevice
        The arm that casts the string.
    camera : CameraDevice
        The camera that films it.
    """

    arm: ArmDevice
    camera: CameraDevice
