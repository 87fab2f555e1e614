"""Measured data as checks need them: trials with the hand's pose and onsets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.dataset import Dataset
from stringcast.data.lost_samples import zero_row_mask
from stringcast.data.rows import spike_mask
from stringcast.stages.common import GRAVITY_M_S2, mad_sigma
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.polyline import step_lengths
from stringcast.stages.string_places import (
    places_wander,
    track_places,
    tracks_at_arc_lengths,
)

INITIAL_FRAMES = 3  # frames that give the initial place
MOVED_SHARE = 0.03  # of the string's length: a larger distance is motion
MIN_TRACK_FRAMES = 5
MIN_NOISE_SAMPLES = 60  # fourth differences for the noise of a place
MAX_STRETCH = 1.25  # duration of five frames without a gap, over the usual one
MAX_REPEATED_SHARE = 0.2  # of coordinates equal to those before
# in a smoothed track, frames this far apart scatter more than neighbours, by this ratio
SMOOTHING_STRIDE, MIN_SMOOTHING_RATIO = 4, 2.0
CLEAR_SIGMAS = 8.0  # in noise sigmas: a larger distance is certainly motion
# frequency of the second mode of a hanging string in sqrt(g / length): half the second
# zero of Bessel's J0
SECOND_MODE = 2.76
# Nyquist's limit of two holds for data without noise and gaps
SAMPLES_PER_PERIOD = 4.0
# if more than a tenth of the steps between frames exceed this share of the length, the
# string may swing between frames
LEAP_QUANTILE, LEAP_DISTANCE = 0.9, 0.1
SUSPICIOUS_LOST_SHARE = 0.1  # of the rows
MAX_LOST_SHARE = 0.8  # of the rows: with more, motion is not checked


@dataclass(frozen=True)
class CheckedTrial:
    """A trial with derived quantities.

    arm: it may be None if poses were measured. length: of the string [m].
    """

    observation: Observation
    arm: Arm | None
    length: float

    @property
    def name(self) -> str:
        """Name of the trial in the dataset."""
        return self.observation.trial

    @property
    def starts_moving(self) -> bool:
        """Whether the string is stated to move when the trial begins."""
        return self.observation.starts_moving

    @cached_property
    def points(self) -> pd.DataFrame:
        """Valid points, sorted by time and arc length."""
        return self.observation.valid_points.sort_values(["t", "s"], kind="stable")

    @property
    def logged_motion(self) -> pd.DataFrame:
        """Stored joint angles or poses of the grasp."""
        if self.observation.arm is not None:
            return self.observation.arm
        assert self.observation.grasp is not None
        return self.observation.grasp

    @cached_property
    def zero_rows(self) -> np.ndarray:
        """A mask of single rows of the stored motion that are exactly zero, (K,)."""
        has_joints = self.observation.arm is not None
        names = list(JOINTS) if has_joints else ["x", "y", "theta"]
        return zero_row_mask(self.logged_motion[names].to_numpy())

    @cached_property
    def motion(self) -> pd.DataFrame:
        """Joint angles or poses of the grasp, without single rows of zeros."""
        return self.logged_motion[~self.zero_rows]

    @cached_property
    def joints(self) -> np.ndarray | None:
        """Joint angles (K, J) [rad], or None if poses were measured."""
        if self.observation.arm is None:
            return None
        return self.motion[list(JOINTS)].to_numpy()

    @cached_property
    def pose(self) -> np.ndarray:
        """Pose of the grasp (K, 3): x [m], y [m], theta [rad]."""
        if self.joints is not None:
            assert self.arm is not None
            return self.arm.grasp_pose(self.joints)
        return self.motion[["x", "y", "theta"]].to_numpy()

    @cached_property
    def hand_t(self) -> np.ndarray:
        """Times of the hand's poses (K,) [s], by the arm's clock."""
        return self.motion["t"].to_numpy()

    def hand_at(self, times: np.ndarray | float) -> np.ndarray:
        """Interpolate the place of the hand (..., 2) [m] at times (...) [s]."""
        return interpolate_rows(times, self.hand_t, self.pose[:, :2])

    @cached_property
    def frame_t(self) -> np.ndarray:
        """Times at which points were seen (F,) [s], by the camera's clock."""
        return np.unique(self.points["t"])

    @cached_property
    def tracks(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Times (F,) [s] and positions (F, 2) [m] of places seen in enough frames."""
        times, frame = np.unique(self.points["t"], return_inverse=True)
        s, xy = self.points["s"].to_numpy(), self.points[["x", "y"]].to_numpy()
        all_tracks = track_places(frame, s)
        tracks = [track for track in all_tracks if len(track) >= MIN_TRACK_FRAMES]
        if not places_wander(s, all_tracks):
            return [(times[frame[track]], xy[track]) for track in tracks]
        arc_lengths = np.array([np.median(s[track]) for track in tracks])
        return tracks_at_arc_lengths(times, frame, s, xy, arc_lengths)

    @cached_property
    def rate(self) -> float:
        """Mean rate at which a place was seen [1/s], with gaps; NaN for one frame."""
        duration = float(np.ptp(self.frame_t))
        if duration <= 0:
            return np.nan
        frame = np.searchsorted(self.frame_t, self.points["t"])
        tracks = track_places(frame, self.points["s"].to_numpy())
        return float(np.mean([len(track) for track in tracks])) / duration

    @property
    def least_rate(self) -> float:
        """Lowest rate that resolves the swing of a limp string of this length [1/s]."""
        root = float(np.sqrt(GRAVITY_M_S2 / self.length))
        return SAMPLES_PER_PERIOD * SECOND_MODE / (2 * np.pi) * root

    @cached_property
    def is_undersampled(self) -> bool:
        """Whether frames are too few to show the motion.

        A string that hangs from a slow hand needs fewer frames.
        """
        if not self.rate < self.least_rate:
            return False
        steps = [step_lengths(xy) for _, xy in self.tracks]
        if not steps:
            return True
        leap = float(np.quantile(np.concatenate(steps), LEAP_QUANTILE))
        return leap > LEAP_DISTANCE * self.length

    @cached_property
    def noise(self) -> float:
        """Standard deviation of a coordinate [m], or NaN if there are too few frames.

        It is estimated from fourth differences in time at the calmest place. They are
        small in smooth motion, but not at the tip of a fast string.
        """
        scatter = [scatter_of_track(t, xy) for t, xy in self.tracks]
        sufficient = []
        for values in scatter:
            if len(values) >= MIN_NOISE_SAMPLES and values.any():
                sufficient.append(values)
        return min(map(mad_sigma, sufficient or scatter), default=np.nan)

    @cached_property
    def is_smoothed(self) -> bool:
        """Whether errors of neighbouring frames at rest are correlated.

        Independent errors scatter as much between neighbours as between frames farther
        apart.
        """
        onset = self.string_onset
        end = float(self.frame_t[-1]) if onset is None else onset
        near: list[np.ndarray] = []
        far: list[np.ndarray] = []
        for t, xy in self.tracks:
            is_resting = t < end
            if (np.diff(xy[is_resting], axis=0) == 0).mean() > MAX_REPEATED_SHARE:
                return False  # hidden by the steps of a coarse grid
            near.append(scatter_of_track(t[is_resting], xy[is_resting]))
            for first in range(SMOOTHING_STRIDE):
                rows = np.flatnonzero(is_resting)[first::SMOOTHING_STRIDE]
                far.append(scatter_of_track(t[rows], xy[rows]))
        values = np.concatenate([*far, np.empty(0)])
        if len(values) < MIN_NOISE_SAMPLES:
            return False
        neighbours = mad_sigma(np.concatenate(near))
        return 0 < MIN_SMOOTHING_RATIO * neighbours < mad_sigma(values)

    @cached_property
    def hand_onset(self) -> float | None:
        """Time at which the hand has left its first pose [s, arm's clock], or None."""
        change = np.abs(self.pose - np.median(self.pose[:INITIAL_FRAMES], axis=0))
        turn = np.minimum(change[:, 2], np.pi)
        distance = np.hypot(change[:, 0], change[:, 1]) + self.length * turn
        return _first_time(self.hand_t, distance > MOVED_SHARE * self.length)

    @cached_property
    def string_onset(self) -> float | None:
        """Time at which most of the string has moved [s, camera's clock], or None."""
        noise = 0.0 if np.isnan(self.noise) else self.noise
        threshold = max(MOVED_SHARE * self.length, CLEAR_SIGMAS * noise)
        onsets = []
        for t, xy in (drop_spikes(*track) for track in self.tracks):
            start = np.median(xy[:INITIAL_FRAMES], axis=0)
            has_moved = np.linalg.norm(xy - start, axis=1) > threshold
            # a single point may be an outlier
            onset = _first_time(t[:-1], has_moved[:-1] & has_moved[1:])
            onsets.append(np.inf if onset is None else onset)
        median = float(np.median(onsets)) if onsets else np.inf
        return median if np.isfinite(median) else None


def drop_spikes(t: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times (F,) and positions (F, 2) without those that jump away and back."""
    is_kept = ~spike_mask(t, xy)
    return t[is_kept], xy[is_kept]


def without_spikes(trial: CheckedTrial) -> CheckedTrial:
    """Return a trial without points that jump away and back.

    If points are at other arc lengths in every frame, all of them are kept.
    """
    points = trial.points
    t, s = points["t"].to_numpy(), points["s"].to_numpy()
    xy = points[["x", "y"]].to_numpy()
    tracks = track_places(np.searchsorted(trial.frame_t, t), s)
    if places_wander(s, tracks):
        return trial
    is_kept = np.ones(len(points), dtype=bool)
    for track in tracks:
        is_kept[track] = ~spike_mask(t[track], xy[track])
    observation = replace(trial.observation, points=points[is_kept])
    return replace(trial, observation=observation)


def scatter_of_track(t: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Return fourth divided differences, scaled to the noise of one coordinate.

    Parameters
    ----------
    t : (F,)
        Increasing times [s], which may be uneven.
    xy : (F, 2)
        Positions [m].

    Returns
    -------
    (2 N,)
        Differences [m] whose standard deviation is that of a coordinate. Frames with
        gaps are left out if there are enough others.
    """
    if len(t) < MIN_TRACK_FRAMES:
        return np.empty(0)
    times = np.lib.stride_tricks.sliding_window_view(t, MIN_TRACK_FRAMES)  # (N, 5)
    places = np.lib.stride_tricks.sliding_window_view(xy, MIN_TRACK_FRAMES, axis=0)
    interval = float(np.median(np.diff(t)))
    is_gapless = np.ptp(times, axis=1) < MAX_STRETCH * 4 * interval
    if 2 * is_gapless.sum() >= MIN_NOISE_SAMPLES:
        times, places = times[is_gapless], places[is_gapless]
    distance = (times[:, :, None] - times[:, None, :]) / interval  # (N, 5, 5)
    distance[:, range(MIN_TRACK_FRAMES), range(MIN_TRACK_FRAMES)] = 1.0
    weight = 1 / distance.prod(axis=2)
    weight /= np.linalg.norm(weight, axis=1, keepdims=True)
    return np.einsum("nf,ncf->nc", weight, places).ravel()


def _first_time(t: np.ndarray, condition: np.ndarray) -> float | None:
    return float(t[np.argmax(condition)]) if condition.any() else None


@dataclass(frozen=True, eq=False)
class CheckedDataset:
    """A dataset with the arm, camera and string length [m] that a run would use.

    It is compared by identity, so that its verdict can be cached.
    """

    data: Dataset
    arm: Arm
    camera: Camera
    length: float

    @cached_property
    def trials(self) -> tuple[CheckedTrial, ...]:
        """Trials that can be used."""
        observations = self.data.trials.values()
        return tuple(CheckedTrial(o, self.arm, self.length) for o in observations)

    def with_points(self) -> Iterator[CheckedTrial]:
        """Return the trials with measured points."""
        return (trial for trial in self.trials if len(trial.points))

    def informative_trials(self) -> Iterator[CheckedTrial]:
        """Yield the trials with enough points to show motion and its onset."""
        rows = self.data.row_counts.get(self.points_file)
        lost = rows.missing / rows.total if rows and rows.total else 0.0
        for trial in self.with_points():
            if lost <= MAX_LOST_SHARE and not trial.is_undersampled:
                yield trial

    @property
    def geometry_is_measured(self) -> bool:
        """Whether arm, string and directions are stated to be measured."""
        return self.data.metadata.get("geometry") == "measured"

    def metadata_block(self, name: str) -> Mapping[str, Any]:
        """Return a block of dataset.yaml, which may be empty or missing."""
        return self.data.metadata.get(name) or {}

    def file(self, table: str) -> str:
        """Return the file of a table: Parquet or CSV."""
        for file in self.data.hashes:
            if file.rpartition(".")[0] == table:
                return file
        return table

    @property
    def points_file(self) -> str:
        """The file of the string's points."""
        return self.file("points")

    @property
    def hand_file(self) -> str:
        """The file of the hand's motion."""
        has_poses = any(trial.joints is None for trial in self.trials)
        return self.file("grasp" if has_poses else "arm")
