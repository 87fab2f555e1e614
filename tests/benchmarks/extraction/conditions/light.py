"""Conditions of light.

A lamp at one side, a lamp that flickers, the arm's shadow, and a string like its
background.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from tests.benchmarks.extraction.conditions.condition import (
    Condition,
    ExposureMoment,
    Shot,
    line_coverage,
)


@dataclass(frozen=True)
class Gradient(Condition):
    """A lamp on the left, with less light at the right edge by `fall`."""

    fall: float

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Darken the frame towards the right."""
        return frame * np.linspace(1, 1 - self.fall, frame.shape[1], dtype=np.float32)


@dataclass(frozen=True)
class Flicker(Condition):
    """A lamp on the mains, whose brightness swings by `share` at twice `mains` [Hz]."""

    share: float
    mains: float = 50.0

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Change the brightness of the whole frame.

        The mains are never exactly at their frequency.
        """
        return frame * (
            1 + self.share * np.sin(2 * np.pi * 2 * 1.013 * self.mains * moment.t + 0.5)
        )


@dataclass(frozen=True)
class Shadow(Condition):
    """The arm's hard shadow on the wall.

    It takes `depth` of the wall's light, `right` and `down` of the arm [m].
    """

    depth: float
    right: float = 0.08
    down: float = 0.06

    def change_background(self, wall: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Darken the wall by a shadow as wide as the arm."""
        fallen = moment.joints.mean(axis=0) + np.array([self.right, -self.down])
        return wall * (
            1
            - self.depth
            * line_coverage(moment.shot.camera, fallen, moment.shot.look.arm_width)
        )


@dataclass(frozen=True)
class Contrast(Condition):
    """A string that is only a few grey levels brighter than the wall on average."""

    levels: float

    def change_scene(self, shot: Shot) -> Shot:
        """Return the shot of a string of another brightness."""
        return replace(
            shot, look=replace(shot.look, string=shot.look.background + self.levels)
        )


@dataclass(frozen=True)
class Blobs(Condition):
    """A cloud of dust or a reflection that drifts by.

    It consists of `count` round blobs out of focus, brighter by `levels`.
    """

    count: int
    levels: float
    radius: float = 5.0  # [px]

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Add blobs of light to the frame, at other places in each."""
        spots = np.zeros(frame.shape, np.float32)
        rows, columns = (
            moment.rng.integers(0, size, self.count) for size in frame.shape
        )
        spots[rows, columns] = self.levels * 2 * np.pi * self.radius**2
        return frame + cv2.GaussianBlur(spots, (0, 0), self.radius)
