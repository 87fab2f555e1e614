"""What extraction looks at: frames, where the grasp is in each, and what else is in view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from data.artifacts import JOINTS, Trial
from stages.model.arm import Arm


@dataclass(frozen=True)
class Footage:
    """Frames of one trial.

    t: (F,) times [s]. images: F uint8 arrays (height, width). grasp: (F, 3) pose of the
    grasp at those times. body: (F, J + 1, 2) the arm's joints [m], or None where no arm is in view.
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    grasp: np.ndarray
    body: np.ndarray | None = None


def footage_of(trial: Trial, arm: Arm) -> Footage:
    """A trial of ours: grasp and arm follow from the measured joint angles."""
    t = trial.frames["t"].to_numpy()
    angles = np.stack([np.interp(t, trial.arm["t"], trial.arm[joint]) for joint in JOINTS], axis=-1)
    return Footage(t, trial.images, arm.grasp(angles), arm.joints(angles))
