"""Sightings: where points that are rigid with the arm were seen, and where the model
has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class Sightings:
    """Observations of the arm in one trial."""

    times: np.ndarray
    frame: np.ndarray
    link: np.ndarray
    share: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class SightedTrial:
    """One trial: the joints as the arm reports them, and what was seen of it."""

    name: str
    motion: JointMotion
    sightings: Sightings

    def residuals(self, model: Model, values: np.ndarray) -> np.ndarray:
        """Residuals of candidates, (C, N) [m]: each point as simulated less as seen,
        along its direction. values: (C, P).
        """
        there = points_on_links(
            model.observed_arm(self.motion, values, self.sightings.times),
            self.sightings,
        )
        return np.sum(
            (there - self.sightings.position) * self.sightings.direction, axis=-1
        )


def points_on_links(joints: np.ndarray, sightings: Sightings) -> np.ndarray:
    """The points that were sighted, (C, N, 2) [m]. joints: (C, F, J + 1, 2)."""
    near = joints[:, sightings.frame, sightings.link - 1]
    far = joints[:, sightings.frame, sightings.link]
    return near + sightings.share[:, None] * (far - near)
