"""The target: a box for the tip, with optional direction and speed of arrival."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.stages.model.box import Box

Angle = Annotated[float, Field(ge=-2 * np.pi, le=2 * np.pi)]
AngleTolerance = Annotated[float, Field(gt=0, le=np.pi)]
PositiveSpeed = Annotated[float, Field(gt=0, le=1000)]


@dataclass(frozen=True)
class Target(Box):
    """A box that the tip must enter, and how it must arrive.

    Parameters
    ----------
    direction : float or None
        Direction of the tip's velocity, counter-clockwise from x [rad]; None for any.
    direction_tolerance : float
        Largest deviation from it [rad].
    speed : float or None
        Speed of the tip [m/s]; None for any.
    speed_tolerance : float
        Largest deviation from it [m/s].
    """

    direction: Angle | None = None
    direction_tolerance: AngleTolerance = 0.35
    speed: PositiveSpeed | None = None
    speed_tolerance: PositiveSpeed = 2.0

    @property
    def restricts_arrival(self) -> bool:
        """Whether the tip must arrive in a direction or at a speed."""
        return self.direction is not None or self.speed is not None

    def arrival_error(self, velocity: np.ndarray) -> np.ndarray:
        """Return the larger error of direction and speed, in tolerances.

        Parameters
        ----------
        velocity : ndarray, shape (..., 2)
            Velocity of the tip [m/s].

        Returns
        -------
        ndarray, shape (...)
            0 if direction and speed are free.
        """
        error = np.zeros(velocity.shape[:-1])
        if self.direction is not None:
            angle = np.arctan2(velocity[..., 1], velocity[..., 0]) - self.direction
            deviation = np.abs(np.angle(np.exp(1j * angle)))
            error = deviation / self.direction_tolerance
        if self.speed is not None:
            deviation = np.abs(np.linalg.norm(velocity, axis=-1) - self.speed)
            error = np.maximum(error, deviation / self.speed_tolerance)
        return error

    def is_entered_along(self, path: np.ndarray, time_step: float) -> np.ndarray:
        """Return whether the tip enters the box as required, in each segment of a path.

        Parameters
        ----------
        path : ndarray, shape (..., K, 2)
            Positions of the tip [m].
        time_step : float
            Time between two positions [s].

        Returns
        -------
        ndarray of bool, shape (..., K - 1)
        """
        velocity = np.diff(path, axis=-2) / time_step
        return self.is_crossed_along(path) & (self.arrival_error(velocity) <= 1)
