"""What the report is made from: artifacts, and the strings simulated before and after estimation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from stringcast.data.artifacts import JOINTS, Estimate, Motion, Observation, Points, Trial
from stringcast.stages.hit_test import Verdict, longest_gap
from stringcast.stages.inference.forward import motion_of
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String


@dataclass(frozen=True)
class Cast:
    """One manipulation. before, after: (F, n, 2) strings simulated at the frame times [m] with the
    parameters before and after estimation; NaN where the simulation did not stay finite."""

    motion: Motion
    trial: Trial
    points: Points
    estimate: Estimate | None
    verdict: Verdict
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)

    @cached_property
    def t(self) -> np.ndarray:
        """(F,) times of the frames [s]."""
        return self.trial.frames["t"].to_numpy()

    @property
    def nearest(self) -> int:
        """The frame of the closest approach, the middle one where no tip was read."""
        return self.frame(self.verdict.t) if np.isfinite(self.verdict.t) else len(self.t) // 2

    def frame(self, t: float) -> int:
        """The frame nearest to a time [s]."""
        return int(np.argmin(np.abs(self.t - t)))

    @cached_property
    def levels(self) -> tuple[float, float]:
        """Black and white of the frames, the same for all: the extremes of the frame of the closest approach,
        for a thin string is a smaller part of a frame than any percentile."""
        image = self.trial.images[self.nearest]
        return float(image.min()), float(max(image.max(), image.min() + 1))

    @cached_property
    def measured(self) -> dict[int, np.ndarray]:
        """The centre-lines that were read, by frame: (K, 3) of x, y and arc length [m]."""
        times = self.points.read.groupby("t", sort=True)[["x", "y", "s"]]
        return {self.frame(t): rows.to_numpy() for t, rows in times}

    def tip(self, t: np.ndarray) -> np.ndarray:
        """The tip's way as it is judged, a cubic through the readings. t: (K,) [s]. Returns (K, 2) [m];
        NaN outside the readings and in gaps that are too long to guess."""
        good = self.points.readings[self.points.readings["valid"].astype(bool)]
        if len(good) < 2:
            return np.full((len(t), 2), np.nan)
        read = good["t"].to_numpy()
        gap = np.diff(read)[np.clip(np.searchsorted(read, t, side="right") - 1, 0, len(read) - 2)]
        way = CubicSpline(read, good[["tip_x", "tip_y"]], extrapolate=False)(t)
        return np.where((gap <= longest_gap(self.points.readings))[:, None], way, np.nan)

    def joints(self, arm: Arm) -> np.ndarray:
        """Base, joints and hand as measured, (K, J + 1, 2) [m]."""
        return arm.joints(self.trial.arm[list(JOINTS)].to_numpy())


@dataclass(frozen=True)
class Record:
    """A run. casts is empty where only estimation ran; estimates: all, in order."""

    name: str
    sentence: str
    hit: bool
    model: Model
    target: Box
    obstacles: tuple[Box, ...]
    casts: tuple[Cast, ...]
    estimates: tuple[Estimate, ...]
    config: Mapping[str, Any]
    made_by: Mapping[str, Any]

    @property
    def arm(self) -> Arm:
        """The model's arm."""
        return self.model.arm

    @property
    def camera(self) -> Camera:
        """The model's camera."""
        return self.model.camera

    @property
    def string(self) -> String:
        """The model's string."""
        return self.model.string


def cast_record(
    model: Model,
    observation: Observation,
    made: tuple[Motion, Trial, Points, Estimate | None],
    verdict: Verdict,
    previous: Estimate | None,
) -> Cast:
    """Simulate the performed motion with the parameters before and after its estimation."""
    motion, trial, points, estimate = made
    known = {} if previous is None else previous.values()
    values = np.stack([model.values(known), model.values(known if estimate is None else estimate.values())])
    frames = trial.frames["t"].to_numpy()
    strings = model.seen(motion_of(observation).lasting(frames.max(initial=0.0)), values, frames).points
    return Cast(motion, trial, points, estimate, verdict, strings[0], strings[1])
