"""Distance of a string's points from a rough prediction, at the best clock offset.

The model is the paper's with ten mass points and a ladder of stiffnesses. It need not
be accurate: a wrong arm, unit, direction or pairing of files causes a misfit of a large
share of the string's length, a wrong stiffness or a missing effect of a few hundredths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from stringcast.stages.check.consistency.record import (
    MIN_OVERLAP,
    Measurements,
    Recording,
    Track,
)
from stringcast.stages.check.measured import MOVED_SHARE
from stringcast.stages.common import GRAVITY_M_S2
from stringcast.stages.content_cache import ContentCache
from stringcast.stages.model.effects.rest_curvature import RestCurvature
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.threads import compile_kernel
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.string import String

# Bending and grasp stiffness at 0.3 m and ten mass points [N m/(rad kg)]: from a limp
# string to a strip that keeps the hand's direction, in compliant grasps
YIELDING = (
    (0.01, 0.001),
    (1.0, 0.5),
    (4.0, 0.01),
    (4.0, 2.0),
    (8.0, 4.0),
    (15.0, 0.1),
    (15.0, 7.0),
    (22.0, 11.0),
    (30.0, 15.0),
    (50.0, 25.0),
    (90.0, 45.0),
    (200.0, 100.0),
)
# ... and in clamps: between hand and first point is half a segment, twice as stiff as a
# whole one
CLAMPED_BENDING = (0.3, 1, 2, 4, 6, 8, 11, 15, 21, 30, 42, 60, 90, 130, 200)
STIFFNESS_LADDER = (*YIELDING, *((float(b), 2.0 * b) for b in CLAMPED_BENDING))
REFERENCE_LENGTH_M = 0.3
# sets that are tried, by the angle from end to end [rad]: those of spools with a
# circumference of a third of the length and more
STRAIGHT = (0.0,)
WITH_SET = (-2.25, -1.5, -0.75, 0.75, 1.5, 2.25)
OTHER_PARAMETERS = {
    "axial_stiffness": 6e5,
    "axial_damping": 30.0,
    "linear_drag": 0.3,
    "quadratic_drag": 0.2,
}
DAMPING_TIME_S = 1e-3  # damping over stiffness
TICK_S = 0.005
LEAD_S = 0.3  # of rest before the motion
MAX_DURATION_S = 10.0
MIN_HAND_PATH = 0.1  # in lengths: after a shorter path nothing is predicted
MAX_FRAMES = 60  # of a track
MIN_FRAMES = 5
MAX_KEPT_PREDICTIONS = 16  # about 1 MB each
MAX_KEPT_TRACKS = 256
OFFSET_STEP_S = 0.02
# arc lengths that are tried if none is stated, in lengths
ARC_LENGTH_GRID = np.arange(0.2, 1.001, 0.1)


class Horizon(NamedTuple):
    """The part of a motion that is predicted.

    It is short in fast casts, in which errors of the model grow, and longer in slow
    motion.

    Attributes
    ----------
    duration
        Duration after the onset, in sqrt(length / g).
    swung
        Least distance moved in it, in lengths.
    """

    duration: float
    swung: float


WHOLE_MOTION = Horizon(2.5, 0.7)
BEGINNING = Horizon(1.2, 0.3)


@dataclass(frozen=True)
class Prediction:
    """Predicted strings of all stiffnesses in a trial.

    Attributes
    ----------
    t
        Times (N,) [s] by the arm's clock, every TICK_S.
    nodes
        Positions (C, N, n, 2) [m], evenly spaced along the string.
    length
        Length of the string [m].
    horizon
        The predicted part of the motion.
    """

    t: np.ndarray
    nodes: np.ndarray
    length: float
    horizon: Horizon

    def points(self, s: float) -> np.ndarray:
        """Return positions (C, N, 2) [m] at an arc length [m]."""
        last = self.nodes.shape[2] - 1
        place = np.clip(s / self.length, 0, 1) * last
        before = min(int(place), last - 1)
        share = place - before
        below, above = self.nodes[:, :, before], self.nodes[:, :, before + 1]
        return below + share * (above - below)


def predict(
    measured: Measurements,
    recording: Recording,
    horizon: Horizon = WHOLE_MOTION,
    set_angles: Sequence[float] = STRAIGHT,
) -> Prediction | None:
    """Predict the string of a trial.

    Returns None if the string moves from the beginning or the hand hardly moves.

    set_angles: angles by which strings are bent from end to end at rest [rad].
    """
    length = measured.length
    if recording.starts_moving or recording.is_restless or length is None:
        return None
    t, first = np.unique(recording.t, return_index=True)
    pose = measured.pose(recording)[first]
    is_known = np.isfinite(pose).all(axis=1)
    t, pose = t[is_known], pose[is_known]
    if len(t) < MIN_FRAMES:
        return None
    lever = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
    end = pose[:, :2] + length * lever
    span = motion_span(t, end, length, horizon)
    if span.path < MIN_HAND_PATH * length:
        return None
    in_span = span.contains(t)
    if in_span.sum() < MIN_FRAMES:
        return None
    moving_t, moving_pose = t[in_span].astype(float), pose[in_span].astype(float)
    # Cached, because many corrections change only the points
    times, nodes = _KEPT_LADDERS.find_or_make(
        [moving_t, moving_pose, np.array([length, *set_angles])],
        lambda: simulate_ladder(length, set_angles, moving_t, moving_pose),
    )
    return Prediction(times, nodes, length, horizon)


def simulate_ladder(
    length: float, set_angles: Sequence[float], t: np.ndarray, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate strings of all stiffnesses; return `Prediction.t` and `.nodes`.

    t, pose: times (K,) [s] of the hand and its poses (K, 3).
    """
    motion = resample_hand_motion(t, pose, TICK_S)
    rungs = []
    for set_angle in set_angles:
        string, values = ladder(length, set_angle)
        rungs.append(simulate(string, motion, values, motion.times).points)
    nodes = np.concatenate(rungs)
    nodes.flags.writeable = False
    return motion.times, nodes


_KEPT_LADDERS: ContentCache[tuple[np.ndarray, np.ndarray]] = ContentCache(
    MAX_KEPT_PREDICTIONS
)


class MotionSpan(NamedTuple):
    """The time in which a point moves.

    begin, until: [s]. path: largest distance from its first place [m].
    """

    begin: float
    until: float
    path: float

    def contains(self, t: np.ndarray) -> np.ndarray:
        """Return which times (N,) [s] are in the span."""
        return (t >= self.begin) & (t <= self.until)


def motion_span(
    t: np.ndarray, xy: np.ndarray, length: float, horizon: Horizon
) -> MotionSpan:
    """Find the time span of a point's (N, 2) [m] motion within a horizon."""
    first_place = np.median(xy[:3], axis=0)
    distance = np.linalg.norm(xy - first_place, axis=1)
    onset = first_beyond(t, distance, MOVED_SHARE * length, float(t[0]))
    swung = first_beyond(t, distance, horizon.swung * length, float(t[-1]))
    duration = horizon.duration * float(np.sqrt(length / GRAVITY_M_S2))
    until = min(max(onset + duration, swung), onset + MAX_DURATION_S)
    return MotionSpan(onset - LEAD_S, until, float(np.quantile(distance, 0.95)))


def first_beyond(
    t: np.ndarray, distance: np.ndarray, threshold: float, otherwise: float
) -> float:
    """Return the first time (K,) [s] with a distance beyond a threshold."""
    is_beyond = distance > threshold
    is_beyond[:-1] &= is_beyond[1:]  # one sample may be an outlier
    return float(t[np.argmax(is_beyond)]) if is_beyond.any() else otherwise


def ladder(length: float, set_angle: float) -> tuple[String, np.ndarray]:
    """Return strings of a length [m] and set [rad], and the ladder's parameters (C, P).

    Stiffness is scaled with length, to keep its ratio to the weight.
    """
    string = String(length)
    if set_angle:
        string = replace(string, effects=(*string.effects, RestCurvature))
    scale = length / REFERENCE_LENGTH_M
    rows = []
    for bending, grasp in STIFFNESS_LADDER:
        values = OTHER_PARAMETERS | {
            "bending_stiffness": bending * scale,
            "bending_damping": bending * scale * DAMPING_TIME_S,
            "grasp_stiffness": grasp * scale,
            "grasp_damping": grasp * scale * DAMPING_TIME_S,
            "rest_curvature.curvature": set_angle / length,
            "rest_curvature.slope": 0.0,
        }
        rows.append([values[parameter.name] for parameter in string.parameters])
    return string, np.array(rows)


@lru_cache(maxsize=MAX_KEPT_TRACKS)
def thin_track(track: Track, length: float, horizon: Horizon = WHOLE_MOTION) -> Track:
    """Return at most MAX_FRAMES finite frames of the track's motion."""
    is_known = np.isfinite(track.xy).all(axis=1) & np.isfinite(track.t)
    t, xy = track.t[is_known], track.xy[is_known]
    if not len(t):
        return replace(track, t=t, xy=xy)
    chosen = np.flatnonzero(motion_span(t, xy, length, horizon).contains(t))
    step = int(np.ceil(len(chosen) / MAX_FRAMES)) or 1
    return replace(track, t=t[chosen[::step]], xy=xy[chosen[::step]])


def mean_motion(track: Track, length: float) -> float:
    """Return the mean distance of a point from its middle, in string lengths."""
    xy = thin_track(track, length).xy
    distance = np.linalg.norm(xy - xy.mean(axis=0), axis=1)
    return float(distance.mean()) / length


def clock_offsets(prediction: Prediction, tracks: list[Track]) -> np.ndarray:
    """Return offsets (D,) [s] at which tracks overlap enough with the prediction."""
    begin = min(float(track.t[0]) for track in tracks)
    end = max(float(track.t[-1]) for track in tracks)
    low = prediction.t[0] - end
    high = prediction.t[-1] - begin
    offsets = np.arange(low, high + OFFSET_STEP_S, OFFSET_STEP_S)
    wanted = MIN_OVERLAP * min(end - begin, prediction.t[-1] - prediction.t[0])
    overlap = np.minimum(end + offsets, prediction.t[-1]) - np.maximum(
        begin + offsets, prediction.t[0] - LEAD_S
    )
    return offsets[overlap >= wanted]


def track_errors(
    prediction: Prediction, track: Track, s: float, offsets: np.ndarray, scale: float
) -> np.ndarray:
    """Return mean distances (D, C) of a track from predictions, relative to a scale.

    Distances are limited to the scale, which reduces the weight of outliers. Frames
    after the prediction's end are left out; before its beginning the string rests.
    """
    points = prediction.points(s)  # (C, N, 2)
    errors = np.ones((len(offsets), len(points)))
    places = (track.t + offsets[:, None] - prediction.t[0]) / TICK_S  # (D, F)
    _mean_distances(points, track.xy, places, scale, errors)
    return errors


@compile_kernel
def _mean_distances(
    points: np.ndarray,
    track: np.ndarray,
    places: np.ndarray,
    scale: float,
    errors: np.ndarray,
) -> None:
    """Average a track's distances from predictions for `track_errors`.

    points: (C, N, 2). track: (F, 2). places: frame times in ticks of the prediction,
    (D, F). errors: ones (D, C), filled in place where there are enough frames.
    """
    last = points.shape[1] - 1
    for d in range(places.shape[0]):
        within = 0
        for f in range(places.shape[1]):
            within += places[d, f] <= last
        if within < MIN_FRAMES:
            continue
        for c in range(points.shape[0]):
            total = 0.0
            for f in range(places.shape[1]):
                if places[d, f] > last:
                    continue
                place = max(places[d, f], 0.0)
                before = min(int(place), last - 1)
                share = place - before
                first, second = points[c, before], points[c, before + 1]
                x = (1 - share) * first[0] + share * second[0] - track[f, 0]
                y = (1 - share) * first[1] + share * second[1] - track[f, 1]
                distance = np.sqrt(x * x + y * y) / scale
                # not `min`: a diverged string (NaN) has the largest distance
                total += distance if distance < 1.0 else 1.0
            errors[d, c] = total / within
