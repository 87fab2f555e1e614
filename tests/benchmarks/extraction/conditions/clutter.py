"""Clutter: what else is in view and looks like a string."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.benchmarks.extraction.conditions.condition import (
    Condition,
    ExposureMoment,
    Shot,
    line_coverage,
)


@dataclass(frozen=True)
class Cables(Condition):
    """A wall full of lines as wide as the string.

    Half of them are darker and half brighter, by up to `levels`.
    """

    levels: float
    count: int = 60
    seed: int = 5

    def change_scene(self, shot: Shot) -> Shot:
        """Draw lines through random points of the wall."""
        rng, wall = np.random.default_rng(self.seed), shot.wall.copy()
        share = np.linspace(0, 1, 40)[:, None]
        for number in range(self.count):
            # a quadratic curve between three random points of the picture
            a, b, c = shot.camera.world(
                rng.uniform(0, 1, (3, 2)) * [shot.camera.width, shot.camera.height]
            )
            cable = (1 - share) ** 2 * a + 2 * share * (1 - share) * b + share**2 * c
            line = line_coverage(
                shot.camera, cable, shot.look.string_width * rng.uniform(0.5, 1.5)
            )
            wall += line * rng.uniform(0.3, 1) * self.levels * (-1) ** number
        return replace(shot, wall=np.clip(wall, 5, 250))


@dataclass(frozen=True)
class ArmCable(Condition):
    """A cable of the arm itself, which moves with it.

    It runs from elbow to hand behind the arm and sags by `sag` [m].
    """

    brightness: float
    sag: float = 0.12

    def change_background(self, wall: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Draw a parabola between the joints, as wide as the string."""
        first, last = moment.joints.mean(axis=0)[[1, -2]]
        share = np.linspace(0, 1, 40)[:, None]
        line = (
            first
            + share * (last - first)
            - np.array([0, self.sag]) * 4 * share * (1 - share)
        )
        drawn = line_coverage(moment.shot.camera, line, moment.shot.look.string_width)
        return wall + drawn * (self.brightness - wall)
