"""Where frames come from: a source is settings; opened, it is a stream that is read
frame by frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from stringcast.stages.model.camera import Camera


@dataclass(frozen=True)
class Frame:
    """arrived: host time (time.monotonic) at which it was there, not decoded yet [s].
    stamp: the source's own time of it [s], on a clock of its own; NaN if it gives none.
    image: as it came, uint8 (height, width) or (height, width, 3) BGR.
    """

    arrival_time: float
    stamp: float
    image: np.ndarray = field(repr=False)


class Stream(ABC):
    """An open source. remarks: what could not be made sure of, in words."""

    remarks: tuple[str, ...] = ()

    @abstractmethod
    def begin(self) -> None:
        """Begin: frames read from now on are exposed from now on."""

    @abstractmethod
    def read(self) -> Frame | None:
        """Wait for the next frame; None where no more will come."""

    @abstractmethod
    def close(self) -> None:
        """Let go."""


class Source(ABC):
    """Settings of a source. delay: from the middle of the exposure to the quickest
    frames' arrival [s].
    """

    delay: float

    @property
    @abstractmethod
    def name(self) -> str:
        """The source's name in messages."""

    @abstractmethod
    def open(self, camera: Camera) -> Stream:
        """Open it and see that it gives the frames that `camera` promises; raises
        HardwareError if not.
        """

    @abstractmethod
    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """Pictures to look at one by one, as they come, whatever their size. ready:
        waits for a person, where one must do something for them.
        """
