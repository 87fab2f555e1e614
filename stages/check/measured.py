"""Measured data as checks look at them: trial by trial, with the hand's pose worked
out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.dataset import Dataset
from stringcast.stages.common import (
    mad_sigma,
    places_wander,
    points_at_arc_lengths,
    track_places,
)
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera

REST_FRAMES = 3  # frames that tell where the string is at first
MOVED_SHARE = 0.03  # of the string's length: who has gone so far has left his place
MIN_POINTS = 60  # differences from which a place tells its noise
CLEAR_SIGMAS = 8.0  # noises by which a point must have gone
GRAVITY = 9.81  # [m/s2]
# of a hanging string's swings: its frequency in sqrt(g / length), half the second zero
# of Bessel's J0
SECOND_MODE = 2.76
# of a period, at least: two would tell it only if there were neither noise nor gaps
SAMPLES_PER_PERIOD = 4.0
# of the steps from frame to frame, and of the length: who goes further swings in
# between
MOSTLY_SHARE, LEAP_SHARE = 0.9, 0.1
LOST_SHARE = 0.8  # of the rows: from fewer nothing can be said


@dataclass(frozen=True)
class CheckedTrial:
    """One trial. length: of the string [m]."""

    observation: Observation
    arm: Arm
    length: float

    @property
    def name(self) -> str:
        """The trial's name."""
        return self.observation.trial

    @property
    def starts_moving(self) -> bool:
        """The string is said to be in motion when the trial begins."""
        return self.observation.starts_moving

    @cached_property
    def points(self) -> pd.DataFrame:
        """Valid points, in the order of time and arc length."""
        return self.observation.valid_points.sort_values(["t", "s"], kind="stable")

    @cached_property
    def motion(self) -> pd.DataFrame:
        """Joint angles or poses of the grasp, as they are stored."""
        motion = (
            self.observation.arm
            if self.observation.arm is not None
            else self.observation.grasp
        )
        assert motion is not None
        return motion

    @cached_property
    def joints(self) -> np.ndarray | None:
        """Joint angles (K, J) [rad], or None where poses were measured."""
        return (
            None
            if self.observation.arm is None
            else self.motion[list(JOINTS)].to_numpy()
        )

    @cached_property
    def pose(self) -> np.ndarray:
        """Pose of the grasp (K, 3): x [m], y [m], theta [rad]."""
        return (
            self.motion[["x", "y", "theta"]].to_numpy()
            if self.joints is None
            else self.arm.grasp_pose(self.joints)
        )

    @cached_property
    def hand_t(self) -> np.ndarray:
        """Times of the hand's poses (K,) [s], by the arm's clock."""
        return self.motion["t"].to_numpy()

    @cached_property
    def frame_t(self) -> np.ndarray:
        """Times at which points were seen (F,) [s], by the camera's clock."""
        return np.unique(self.points["t"])

    @cached_property
    def tracks(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Times (F,) [s] and positions (F, 2) [m] of each place on the string that was
        seen in five frames or more.
        """
        times, frame = np.unique(self.points["t"], return_inverse=True)
        s, xy = self.points["s"].to_numpy(), self.points[["x", "y"]].to_numpy()
        tracks = track_places(frame, s)
        found = [track for track in tracks if len(track) >= 5]
        if not places_wander(s, tracks):
            return [(times[frame[track]], xy[track]) for track in found]
        lines = points_at_arc_lengths(
            frame, s, xy, np.array([np.median(s[track]) for track in found])
        )
        there = np.isfinite(lines[..., 0])
        return [(times[there[:, k]], lines[there[:, k], k]) for k in range(len(found))]

    @cached_property
    def rate(self) -> float:
        """The rate at which a place of the string was seen [1/s], gaps and missing
        points counted; NaN for one frame.
        """
        _, frame = np.unique(self.points["t"], return_inverse=True)
        lengths = [
            len(track) for track in track_places(frame, self.points["s"].to_numpy())
        ]
        duration = float(np.ptp(self.frame_t))
        return float(np.mean(lengths)) / duration if duration > 0 else float("nan")

    @property
    def least_rate(self) -> float:
        """The least rate that shows how a limp string of this length swings [1/s]."""
        return (
            SAMPLES_PER_PERIOD
            * SECOND_MODE
            / (2 * np.pi)
            * float(np.sqrt(GRAVITY / self.length))
        )

    @cached_property
    def is_undersampled(self) -> bool:
        """Whether it was seen so seldom that how it moves cannot be told: a hand so
        slow that the string only hangs from it needs few frames.
        """
        steps = [np.linalg.norm(np.diff(xy, axis=0), axis=1) for _, xy in self.tracks]
        leaps = (
            not steps
            or float(np.quantile(np.concatenate(steps), MOSTLY_SHARE))
            > LEAP_SHARE * self.length
        )
        return self.rate < self.least_rate and leaps

    @cached_property
    def noise(self) -> float:
        """One standard deviation of a coordinate [m], from fourth differences in time,
        which smooth motion hardly has: of the calmest place, for the tip of a string
        that whips has them. NaN where frames are too few.
        """
        rough = [np.diff(xy, 4, axis=0).ravel() for _, xy in self.tracks]
        enough = [
            some for some in rough if len(some) >= MIN_POINTS and some.any()
        ] or rough
        return float(
            min((mad_sigma(some) for some in enough), default=np.nan) / np.sqrt(70)
        )

    @cached_property
    def hand_onset(self) -> float | None:
        """The time at which the hand has left its first pose [s], by the arm's clock;
        None if it never does.
        """
        gone = np.abs(self.pose - np.median(self.pose[:REST_FRAMES], axis=0))
        away = np.hypot(gone[:, 0], gone[:, 1]) + self.length * np.minimum(
            gone[:, 2], np.pi
        )
        return _first_time(self.hand_t, away > MOVED_SHARE * self.length)

    @cached_property
    def string_onset(self) -> float | None:
        """The time at which most of the string has left its first place [s], by the
        camera's clock; None if it never does.
        """
        noise = 0.0 if np.isnan(self.noise) else self.noise
        least = max(MOVED_SHARE * self.length, CLEAR_SIGMAS * noise)
        onsets = []
        for t, xy in self.tracks:
            away = (
                np.linalg.norm(xy - np.median(xy[:REST_FRAMES], axis=0), axis=1) > least
            )
            # one point alone may be an outlier
            onset = _first_time(t[:-1], away[:-1] & away[1:])
            onsets.append(np.inf if onset is None else onset)
        middle = float(np.median(onsets)) if onsets else np.inf
        return middle if np.isfinite(middle) else None


def _first_time(t: np.ndarray, which: np.ndarray) -> float | None:
    """The first of the times at which something is so."""
    return float(t[np.argmax(which)]) if which.any() else None


@dataclass(frozen=True)
class CheckedDataset:
    """A dataset and what it would be run with. length: of the string [m]."""

    data: Dataset
    arm: Arm
    camera: Camera
    length: float

    @cached_property
    def trials(self) -> tuple[CheckedTrial, ...]:
        """Trials that can be used."""
        return tuple(
            CheckedTrial(observation, self.arm, self.length)
            for observation in self.data.trials.values()
        )

    def with_points(self) -> Iterator[CheckedTrial]:
        """The trials with measured points."""
        return (trial for trial in self.trials if len(trial.points))

    def informative_trials(self) -> Iterator[CheckedTrial]:
        """The trials with enough points to tell how they move, and when they begin to."""
        rows = self.data.row_counts.get(self.file("points"))
        # share that cannot be used
        lost = sum(rows.dropped.values()) / rows.total if rows and rows.total else 0.0
        return (
            t
            for t in self.with_points()
            if lost <= LOST_SHARE and not t.is_undersampled
        )

    def file(self, name: str) -> str:
        """The file of a table, as it is called here: Parquet or CSV."""
        return next(
            (file for file in self.data.hashes if file.rpartition(".")[0] == name), name
        )

    @property
    def hand_file(self) -> str:
        """The file of the hand's motion."""
        return self.file(
            "grasp" if any(trial.joints is None for trial in self.trials) else "arm"
        )
