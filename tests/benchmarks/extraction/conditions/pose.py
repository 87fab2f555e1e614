"""Conditions of the string's pose, which also change the truth."""

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
class BeforeArm(Condition):
    """The string turned about the grasp, in front of the arm.

    Its tip lies `angle` [rad] from the last link.
    """

    angle: float

    def change_scene(self, shot: Shot) -> Shot:
        """Return the shot with the string turned about the grasp at every moment.

        It lies at `angle` to the last link.
        """
        grasp = shot.strings[:, :1]
        wanted = _directions(shot.joints[:, -2] - shot.joints[:, -1]) + self.angle
        turned = _rotations(wanted - _directions(shot.strings[:, -1] - grasp[:, 0]))
        return replace(
            shot,
            strings=grasp + np.einsum("mij,mnj->mni", turned, shot.strings - grasp),
        )


@dataclass(frozen=True)
class BehindArm(BeforeArm):
    """A string that passes behind the arm, which hides it."""

    def change_light(self, frame: np.ndarray, moment: ExposureMoment) -> np.ndarray:
        """Draw the arm over the string."""
        shot = moment.shot
        arm = np.mean(
            [
                line_coverage(shot.camera, joints, shot.look.arm_width)
                for joints in moment.joints
            ],
            axis=0,
        )
        return frame + arm * (shot.look.arm - frame)


@dataclass(frozen=True)
class StringLoop(Condition):
    """A loop in the middle of the string, made of `length` [m] of it.

    The string crosses itself at about a right angle.
    """

    length: float

    def change_scene(self, shot: Shot) -> Shot:
        """Add the directions of a loop to those of the string.

        They turn smoothly 45 degrees away, 270 back, and 45 on.
        """
        pieces = np.repeat(np.diff(shot.strings, axis=1) / 4, 4, axis=1)
        s = np.cumsum(np.linalg.norm(pieces, axis=-1).mean(axis=0))
        share = (s - s[-1] / 2) / self.length + 0.5
        turned = np.interp(share, [0, 0.3, 0.7, 1], np.radians([0, 45, 315, 360]))
        bent = np.einsum("nij,mnj->mni", _rotations(turned), pieces)
        return replace(
            shot,
            strings=np.concatenate(
                [shot.strings[:, :1], shot.strings[:, :1] + bent.cumsum(axis=1)], 1
            ),
        )


def _directions(vectors: np.ndarray) -> np.ndarray:
    """Return angles from +x [rad] of vectors (..., 2)."""
    return np.asarray(np.arctan2(vectors[..., 1], vectors[..., 0]))


def _rotations(angle: np.ndarray) -> np.ndarray:
    """Return rotations (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.moveaxis(np.array([[c, -s], [s, c]]), (0, 1), (-2, -1))
