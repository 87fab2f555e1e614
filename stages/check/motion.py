"""How hand and string move: frozen readings, jumps, a string that hangs upwards, motion
that says nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.stages.check.clocks import time_unit_factor, usual_interval
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.gravity import median_gravity
from stringcast.stages.check.measured import CLEAR_SIGMAS, GRAVITY, CheckedDataset
from stringcast.stages.check.mistakes import impossible_views

# [s] for which a reading is the same to the last digit while others change
MAX_FROZEN_S = 0.1
# of the steps of moving points: so many are not by chance the same to the last digit
MAX_REPEATED_SHARE = 0.05
TURN_JUMP_RAD = 1.5 * np.pi  # a jump so large within two samples is a wrapped angle
# times less and more than gravity: of 17 benches 5 to 19 m/s2, of a clamped strip 41
MIN_GRAVITY, MAX_GRAVITY_RATIO = 4.0, 10.0
# of its arc length: so far above the grasp no limp string rests
MIN_HEIGHT_LENGTHS = 0.5


def check_frozen_joints(measured: CheckedDataset) -> Iterator[Finding]:
    """Joints whose reading never changes, or stands still while the others move."""
    for seen in measured.trials:
        if seen.joints is None or seen.hand_onset is None:
            continue
        moving = (np.diff(seen.joints, axis=0) != 0).any(axis=1)
        for number, reading in enumerate(seen.joints.T, start=1):
            same = (np.diff(reading) == 0) & moving
            runs = np.diff(np.flatnonzero(np.concatenate([[True], ~same, [True]]))) - 1
            longest = float(runs.max()) * usual_interval(seen.hand_t)
            said = (
                f"it stands still for {longest:.2f} s while other joints move"
                if longest > MAX_FROZEN_S
                else ""
            )
            said = "it never changes" if np.ptp(reading) == 0 else said
            if said:
                remedy = f"If joint {number} moved, its log is frozen: leave the trial out, or record it again"
                yield Finding(
                    Severity.WARNING,
                    measured.hand_file,
                    f"q{number}",
                    said,
                    remedy,
                    (seen.name,),
                )


def check_wrapped_angles(measured: CheckedDataset) -> Iterator[Finding]:
    """Joint angles that jump by a turn. Of theta it does not matter: a direction is the
    same after a turn.
    """
    for seen in measured.trials:
        if seen.joints is None:
            continue
        for number, reading in enumerate(seen.joints.T, start=1):
            jumps = int((np.abs(np.diff(reading)) > TURN_JUMP_RAD).sum())
            if jumps and np.ptp(reading) < 2 * np.pi + 0.01:
                said = f"{jumps} jump(s) by a whole turn: the angle is wrapped at +-pi"
                remedy = "Unwrap it, as numpy.unwrap does"
                yield Finding(
                    Severity.ERROR,
                    measured.hand_file,
                    f"q{number}",
                    said,
                    remedy,
                    (seen.name,),
                )


def check_hanging(measured: CheckedDataset) -> Iterator[Finding]:
    """A string that rests above the hand."""
    for seen in measured.with_points():
        first = seen.points[seen.points["t"] == seen.frame_t[0]]
        tip = first.iloc[-1]
        grasp = np.interp(tip["t"], seen.hand_t, seen.pose[:, 1])
        above = float(tip["y"] - grasp)
        if (
            not seen.starts_moving
            and tip["s"] > 0.5 * seen.length
            and MIN_HEIGHT_LENGTHS * tip["s"] < above < seen.length
        ):
            said = f"at rest the string's end is {above:.3f} m above the grasp"
            remedy = "If it hung down, y points down: multiply y of points and of the hand by -1 (and theta too)"
            yield Finding(
                Severity.WARNING,
                measured.file("points"),
                "y",
                said,
                remedy,
                (seen.name,),
            )


def check_repeated_points(measured: CheckedDataset) -> Iterator[Finding]:
    """Points that a tracker repeated to the last digit."""
    for seen in measured.with_points():
        same, moved = 0, 0
        for _, xy in seen.tracks:
            steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
            far = steps > CLEAR_SIGMAS * np.nan_to_num(seen.noise) + 1e-12
            beside = np.concatenate([far[1:], [False]]) | np.concatenate(
                [[False], far[:-1]]
            )
            same += int(((steps == 0) & beside).sum())
            moved += int(far.sum())
        share = same / (same + moved) if moved else 0.0
        if share > MAX_REPEATED_SHARE:
            said = f"{share:.0%} of the steps of moving points are none: the same to the last digit"
            remedy = "If the tracker held its last value, drop those rows or set 'valid' to false"
            yield Finding(
                Severity.WARNING,
                measured.file("points"),
                "x, y",
                said,
                remedy,
                (seen.name,),
            )


def check_fall(measured: CheckedDataset) -> Iterator[Finding]:
    """A string that falls as nothing does on Earth."""
    if impossible_views(measured) or any(
        time_unit_factor(seen.frame_t) != 1 for seen in measured.with_points()
    ):
        return  # which makes it fall otherwise, and is said
    seen = median_gravity(measured.informative_trials())
    if not (seen < GRAVITY / MIN_GRAVITY or seen > GRAVITY * MAX_GRAVITY_RATIO):
        return
    said = f"the string's end falls with {seen:.2g} m/s2 as it seems, and not with {GRAVITY}"
    if seen < GRAVITY:
        remedy = "Of slow motion count the frames as filmed: times are too long as they are, or lengths too small"
    else:
        remedy = "See in which unit lengths and times are; a very stiff string may seem to fall so fast"
    yield Finding(Severity.WARNING, measured.file("points"), "t, x, y", said, remedy)


def check_stillness(measured: CheckedDataset) -> Iterator[Finding]:
    """A trial in which nothing happens."""
    for seen in measured.with_points():
        if seen.hand_onset is None and seen.string_onset is None:
            said = "neither hand nor string leaves its place"
            yield Finding(
                Severity.WARNING,
                measured.hand_file,
                "t",
                said,
                "It says little: leave it out",
                (seen.name,),
            )
