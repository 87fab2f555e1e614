"""The role of a camera: a source of frames, which opens as a stream.

A source is settings; a stream is read frame by frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from stringcast.stages.model.camera import Camera


@dataclass(frozen=True)
class Frame:
    """A single frame with its times of arrival and exposure.

    Attributes
    ----------
    arrival_time
        Host time of its arrival, before it was decoded (time.monotonic) [s].
    stamp
        The source's own time, on its own clock; NaN if it gives none [s].
    image : (height, width) or (height, width, 3) uint8
        Grey, or BGR.
    """

    arrival_time: float
    stamp: float
    image: np.ndarray = field(repr=False)


class Stream(ABC):
    """An open source; its remarks state what could not be verified."""

    remarks: tuple[str, ...] = ()

    @abstractmethod
    def begin(self) -> None:
        """Drop old frames, so that those read from now on are exposed from now on."""

    @abstractmethod
    def read(self) -> Frame | None:
        """Wait for the next frame; return None if no more will come."""

    @abstractmethod
    def close(self) -> None:
        """Close the stream and release its device."""


class Source(ABC):
    """The settings of a source.

    Attributes
    ----------
    delay
        From the middle of the exposure to the arrival of the quickest frames [s].
    """

    delay: float

    @property
    @abstractmethod
    def name(self) -> str:
        """The source's name in messages."""

    @abstractmethod
    def open(self, camera: Camera) -> Stream:
        """Open the source and check its frames.

        Parameters
        ----------
        camera
            The camera as it should be: size and rate.

        Returns
        -------
        Stream
            The open source.

        Raises
        ------
        HardwareError
            If it cannot be opened or gives other frames.
        """

    @abstractmethod
    def stills(
        self, camera: Camera, ready: Callable[[], object]
    ) -> Iterator[np.ndarray]:
        """Yield pictures of any size one by one, for a calibration.

        Parameters
        ----------
        camera
            The camera as it should be.
        ready
            Waits for the user, if the pictures need one.

        Yields
        ------
        (height, width) or (height, width, 3) ndarray of uint8
            A picture.
        """
