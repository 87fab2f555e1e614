"""Sightings of the arm: seen and simulated positions of points on its links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class Sightings:
    """Observations of points on the arm in one trial.

    Attributes
    ----------
    times
        Times of the frames (F,) [s], by the camera's clock.
    frame
        Index of each sighting's frame (N,).
    link
        Number of each sighting's link (N,), from 1.
    share
        Position of the point along the link (N,), from 0 at its joint to 1.
    position
        Seen position (N, 2) [m].
    direction
        Unit vector along which the position was measured (N, 2).
    sigma
        Standard deviation of the measurement (N,) [m].
    """

    times: np.ndarray
    frame: np.ndarray
    link: np.ndarray
    share: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class SightedTrial:
    """Reported joint motion of one trial, and the sightings of the arm."""

    name: str
    motion: JointMotion
    sightings: Sightings

    def residuals(self, model: Model, values: np.ndarray) -> np.ndarray:
        """Return simulated minus seen positions (C, N) [m] in the measured directions.

        values: parameters of candidates (C, P).
        """
        seen = self.sightings
        joints = model.observed_arm(self.motion, values, seen.times)
        error = points_on_links(joints, seen) - seen.position
        return np.sum(error * seen.direction, axis=-1)


def points_on_links(joints: np.ndarray, sightings: Sightings) -> np.ndarray:
    """Return the sighted points (C, N, 2) [m] for joints (C, F, J + 1, 2) [m]."""
    near = joints[:, sightings.frame, sightings.link - 1]
    far = joints[:, sightings.frame, sightings.link]
    return near + sightings.share[:, None] * (far - near)
