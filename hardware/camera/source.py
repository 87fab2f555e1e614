"""Sources of frames, and the streams that they open.

A source holds settings; a stream yields frames.
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
        Host time of arrival, before decoding (time.monotonic) [s].
    stamp
        Time stamp on the source's clock; NaN without [s].
    image : (height, width) or (height, width, 3) uint8
        Grey, or BGR.
    """

    arrival_time: float
    stamp: float
    image: np.ndarray = field(repr=False)


class Stream(ABC):
    """An open source; `remarks` lists unverified properties."""

    remarks: tuple[str, ...] = ()

    @abstractmethod
    def begin(self) -> None:
        """Drop buffered frames, so that the next one is exposed from now on."""

    @abstractmethod
    def read(self) -> Frame | None:
        """Wait for the next frame; return None after the last."""

    @abstractmethod
    def close(self) -> None:
        """Close the stream and release its device."""


class Source(ABC):
    """The settings of a source.

    Attributes
    ----------
    delay
        Time from mid-exposure to the arrival of the quickest frames [s].
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
            The required size and rate.

        Returns
        -------
        Stream
            The open source.

        Raises
        ------
        HardwareError
            If the source cannot be opened or gives other frames.
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
            Waits for the user, if needed.

        Yields
        ------
        (height, width) or (height, width, 3) ndarray of uint8
            A picture.
        """
