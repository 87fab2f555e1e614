"""The two device interfaces of a lab: an arm that follows velocity commands and a
camera that films.

`stages.execute` knows these and nothing else of the hardware. A device that cannot do
what is asked raises `HardwareError` with the device, what is wrong and the remedy, and
raises it before anything moves wherever it can be known before.
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
    """A device cannot do what is asked; the message names the device, the fault and the
    remedy.
    """


@dataclass(frozen=True)
class Performance:
    """The record of one motion by an arm. `arm` and `ticks` are tables ARM and TICKS,
    `link` is table LINK (data.artifacts).

    begun: host time (time.monotonic) at which the first command was due [s].
    """

    arm: pd.DataFrame
    ticks: pd.DataFrame
    link: pd.DataFrame
    started_at: float


@dataclass(frozen=True)
class Recording:
    """The frames of one motion by a camera: `t` (F,) mid-exposure times [s] on the
    camera's clock, 0 at the start of the movement, and `images`, F uint8 arrays
    (height, width).

    A camera that can be late or lose frames reports it: `counts` has a row a frame,
    `summary` is about them all: the optional columns of tables FRAMES and LINK
    (data.artifacts). fault: why it cannot be trusted; empty if it can.
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    counts: pd.DataFrame = field(default_factory=pd.DataFrame)
    summary: Mapping[str, Any] = field(default_factory=dict)
    fault: str = ""


class ArmDevice(Protocol):
    """An arm. A context manager: entering opens and checks the link, leaving stops the
    arm, always.
    """

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def angles(self) -> np.ndarray:
        """Joint angles as measured now, (J,) [rad]."""

    def check(self, commands: pd.DataFrame) -> None:
        """Refuse a table COMMANDS that leaves a limit of the arm anywhere; nothing
        moves.
        """

    def move_to(self, angles: Sequence[float]) -> None:
        """Go slowly to joint angles [rad] and wait until the string has settled."""

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Play a table COMMANDS (t, q1..q3, w1..w3) tick by tick; the arm is at rest at
        the end.
        """


class CameraDevice(Protocol):
    """A camera. Filming goes on in the background between `start` and `stop`."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def start(self) -> None:
        """Begin filming; raises HardwareError where no frame comes."""

    def stop(self, moved_at: float) -> Recording:
        """End filming, once the last frames are there. `moved_at`: host time
        (time.monotonic) of the start of the movement.
        """


@dataclass(frozen=True)
class Lab:
    """An arm and the camera that watches it."""

    arm: ArmDevice
    camera: CameraDevice
