"""What the report is made from: artifacts, and the strings simulated before and after estimation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from data.artifacts import JOINTS, Estimate, Motion, Observation, Points, Trial
from stages.estimate.forward import hand
from stages.generate import Box
from stages.judge import Verdict
from stages.model.arm import Arm
from stages.model.camera import Camera
from stages.model.string import String, simulate


@dataclass(frozen=True)
class Cast:
    """One manipulation. before, after: (F, n, 2) strings simulated at the frame times [m] with the
    parameters before and after estimation."""

    motion: Motion
    trial: Trial
    points: Points
    estimate: Estimate | None
    verdict: Verdict
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)

    @property
    def nearest(self) -> int:
        """The frame of the closest approach, the middle one where no tip was read."""
        t = self.trial.frames["t"].to_numpy()
        return int(np.argmin(np.abs(t - self.verdict.t))) if np.isfinite(self.verdict.t) else len(t) // 2

    def measured(self, frame: int) -> np.ndarray:
        """The centre-line read in a frame, (K, 2) [m]; empty where it could not be read."""
        t = self.trial.frames["t"].iloc[frame]
        points = self.points.points
        return points.loc[np.abs(points["t"] - t) < 1e-9, ["x", "y"]].to_numpy()

    def hand(self, arm: Arm) -> np.ndarray:
        """The hand's way as measured, (K, 2) [m]."""
        return arm.grasp(self.trial.arm[list(JOINTS)].to_numpy())[:, :2]


@dataclass(frozen=True)
class Record:
    """A run. casts is empty where only estimation ran; estimates: all, in order."""

    name: str
    sentence: str
    hit: bool
    arm: Arm
    camera: Camera
    string: String
    target: Box
    obstacles: tuple[Box, ...]
    casts: tuple[Cast, ...]
    estimates: tuple[Estimate, ...]
    config: Mapping[str, Any]
    made_by: Mapping[str, Any]


def cast_record(
    string: String,
    arm: Arm,
    observation: Observation,
    made: tuple[Motion, Trial, Points, Estimate | None],
    verdict: Verdict,
    previous: Estimate | None,
) -> Cast:
    """Simulate the performed motion with the parameters before and after its estimation."""
    motion, trial, points, estimate = made
    known = {} if previous is None else previous.values()
    values = np.stack([string.values(known), string.values(known if estimate is None else estimate.values())])
    strings = simulate(string, hand(arm, observation), values, trial.frames["t"].to_numpy()).points
    return Cast(motion, trial, points, estimate, verdict, strings[0], strings[1])
