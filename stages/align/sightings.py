"""Sightings of the arm: where points on its links were seen and are simulated."""

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
        Number of its link (N,), from 1.
    share
        Where on the link the point is (N,), from 0 at its joint to 1.
    position
        Where it was seen (N, 2) [m].
    direction
        Unit vector (N, 2) along which it was measured.
    sigma
        Standard deviation of that measurement (N,) [m].
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
    """The joints in one trial as the arm reports them, and what was seen of it."""

    name: str
    motion: JointMotion
    sightings: Sightings

    def residuals(self, model: Model, values: np.ndarray) -> np.ndarray:
        """Return simulated less seen positions along the measured directions.

        Parameters
        ----------
        model
            The model of arm and camera.
        values
            Parameters of candidates (C, P).

        Returns
        -------
        array
            Residuals (C, N) [m].
        """
        seen = self.sightings
        joints = model.observed_arm(self.motion, values, seen.times)
        error = points_on_links(joints, seen) - seen.position
        return np.asarray(np.sum(error * seen.direction, axis=-1))


def points_on_links(joints: np.ndarray, sightings: Sightings) -> np.ndarray:
    """Return the sighted points (C, N, 2) [m] of joints at (C, F, J + 1, 2) [m]."""
    near = joints[:, sightings.frame, sightings.link - 1]
    far = joints[:, sightings.frame, sightings.link]
    return np.asarray(near + sightings.share[:, None] * (far - near))
