"""Measurements: the hand's motion and points of the string in each trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

MIN_OVERLAP = 0.6  # share of a track's frames that overlap at a clock offset
REST_FRAMES = 5  # frames whose median is the place at rest


@dataclass(frozen=True, eq=False)
class Track:
    """A point of the string over time.

    Attributes
    ----------
    point
        Its name.
    s
        Its arc length [m]; None if it is not stated.
    t, xy
        Times (F,) [s] by the camera's clock, and positions (F, 2) [m].
    """

    point: str
    s: float | None
    t: np.ndarray
    xy: np.ndarray

    @property
    def rest_place(self) -> np.ndarray:
        """Median position of the first frames (2,) [m]."""
        return np.median(self.xy[:REST_FRAMES], axis=0)

    @property
    def rest_spread(self) -> float:
        """Largest distance of the first frames from their median position [m]."""
        away = self.xy[:REST_FRAMES] - self.rest_place
        return float(np.linalg.norm(away, axis=1).max())


@dataclass(frozen=True)
class Recording:
    """A trial as it was recorded.

    Attributes
    ----------
    name
        The trial's name.
    t
        Times of the hand (K,) [s] by the arm's clock.
    joints
        Joint angles (K, J) [rad], base first, or None.
    hand
        Measured poses (K, 3) of the grasp: x, y [m], theta [rad], or None.
    tracks
        The points of the string, each with a frame at least.
    starts_moving
        Whether the string is stated to move when the trial begins.
    is_restless
        Whether it seems to move although it is stated to be at rest.
    """

    name: str
    t: np.ndarray
    joints: np.ndarray | None
    hand: np.ndarray | None
    tracks: tuple[Track, ...]
    starts_moving: bool = False
    is_restless: bool = False

    def track(self, point: str) -> Track | None:
        """Return the track of a point; None if it was not seen."""
        return next((track for track in self.tracks if track.point == point), None)

    def with_tracks(self, change: Callable[[Track], Track]) -> Recording:
        """Return the trial with each track changed."""
        return replace(self, tracks=tuple(map(change, self.tracks)))


@dataclass(frozen=True)
class Measurements:
    """All trials with the stated geometry.

    Attributes
    ----------
    recordings
        The trials.
    links, base
        Lengths of the arm's links and place of joint 1 [m].
    length
        Length of the string [m]; None if it is not stated.
    base_is_measured
        Whether the base of the arm is stated to be measured, so that it is not fitted.
    """

    recordings: tuple[Recording, ...]
    links: tuple[float, ...] = ()
    base: tuple[float, float] = (0.0, 0.0)
    length: float | None = None
    base_is_measured: bool = False

    @property
    def tracks(self) -> list[Track]:
        """The tracks of all trials."""
        return [track for recording in self.recordings for track in recording.tracks]

    @property
    def stated_arc_lengths(self) -> list[float]:
        """The stated arc lengths of tracks [m]."""
        return [track.s for track in self.tracks if track.s is not None]

    @property
    def has_joints(self) -> bool:
        """Whether joint angles were recorded."""
        return any(recording.joints is not None for recording in self.recordings)

    def pose(self, recording: Recording) -> np.ndarray:
        """Return the hand's pose (K, 3) in a trial: x, y [m], theta [rad]."""
        if recording.joints is None:
            assert recording.hand is not None
            return recording.hand
        return arm_poses(recording.joints, self.links, self.base)

    def with_recordings(self, change: Callable[[Recording], Recording]) -> Measurements:
        """Return the measurements with each recording changed."""
        return replace(self, recordings=tuple(map(change, self.recordings)))

    def with_tracks(self, change: Callable[[Track], Track]) -> Measurements:
        """Return the measurements with each track changed."""
        return self.with_recordings(lambda recording: recording.with_tracks(change))


def arm_poses(
    joints: np.ndarray,
    links: Sequence[float] | np.ndarray,
    base: Sequence[float] | np.ndarray,
) -> np.ndarray:
    """Compute poses (K, 3) of the grasp of a planar arm: x, y [m] and theta [rad].

    joints: angles (K, J) [rad], base first, each relative to the previous link. links:
    lengths (J,) [m]. base: place of joint 1 (2,) [m].
    """
    angles = np.cumsum(joints, axis=1)  # of the links, from +x
    x = base[0] + (np.cos(angles) * links).sum(axis=1)
    y = base[1] + (np.sin(angles) * links).sum(axis=1)
    return np.stack([x, y, angles[:, -1]], axis=-1)
