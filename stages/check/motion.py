"""Checks of motion: frozen and wrapped readings, gravity, no motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.lost_samples import find_runs
from stringcast.stages.check.clocks import time_unit_factor, usual_interval
from stringcast.stages.check.consistency.check import (
    dataset_answer,
    impossible_trials,
)
from stringcast.stages.check.finding import Finding, note, warning
from stringcast.stages.check.gravity import median_gravity
from stringcast.stages.check.measured import CheckedDataset, CheckedTrial
from stringcast.stages.common import GRAVITY_M_S2

# longest time of a constant reading of a joint while others change
MAX_FROZEN_S = 0.1
# factors by which estimated gravity may be smaller and larger: 17 datasets give 5 to
# 19 m/s2, a clamped strip 41
GRAVITY_RATIO_LOW, GRAVITY_RATIO_HIGH = 4.0, 10.0


def joint_readings(
    dataset: CheckedDataset,
) -> Iterator[tuple[CheckedTrial, str, np.ndarray]]:
    """Yield trial, column and angles (K,) [rad] of every joint."""
    for trial in dataset.trials:
        if trial.joints is not None:
            for number, angles in enumerate(trial.joints.T, start=1):
                yield trial, f"q{number}", angles


def check_frozen_joints(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find joints whose reading is constant while others move."""
    for trial, field, angles in joint_readings(dataset):
        if trial.joints is None or trial.hand_onset is None:
            continue
        if np.ptp(angles) == 0:
            statement = "it never changes"
        else:
            is_moving = (np.diff(trial.joints, axis=0) != 0).any(axis=1)
            is_frozen = (np.diff(angles) == 0) & is_moving
            steps = [last - first + 1 for first, last in find_runs(is_frozen)]
            longest = max(steps, default=0) * usual_interval(trial.hand_t)
            if not longest > MAX_FROZEN_S:
                continue
            statement = f"it stands still for {longest:.2f} s while other joints move"
        remedy = (
            f"If joint {field[1:]} moved, its log is frozen: leave the trial out, or "
            "record it again"
        )
        yield warning(dataset.hand_file, field, statement, remedy, trial.name)


def check_wrapped_angles(dataset: CheckedDataset) -> Iterator[Finding]:
    """Report joint angles that jumped by a turn, and were unwrapped.

    For theta it does not matter: a direction is the same after a turn.
    """
    for file, rows in dataset.data.row_counts.items():
        for joint, trials in rows.unwrapped.items():
            statement = "it jumps by whole turns, as a wrapped angle; it was unwrapped"
            yield note(file, joint, statement, "Nothing needs to be done", *trials)


def check_fall(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find strings whose fall contradicts gravity."""
    if impossible_trials(dataset) or dataset_answer(dataset).proposals:
        return  # another check reports what changes the fall
    if any(time_unit_factor(trial.frame_t) != 1 for trial in dataset.with_points()):
        return
    gravity = median_gravity(dataset.informative_trials())
    if gravity < GRAVITY_M_S2 / GRAVITY_RATIO_LOW:
        remedy = (
            "Of slow motion count the frames as filmed: either times are too long, or "
            "lengths too small"
        )
    elif gravity > GRAVITY_M_S2 * GRAVITY_RATIO_HIGH:
        remedy = (
            "See in which unit lengths and times are; a very stiff string may seem to "
            "fall so fast"
        )
    else:
        return
    statement = (
        f"the string's end seems to fall with {gravity:.2g} m/s2, and not with "
        f"{GRAVITY_M_S2}"
    )
    yield warning(dataset.points_file, "t, x, y", statement, remedy)


def check_stillness(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find trials without any motion."""
    for trial in dataset.with_points():
        if trial.hand_onset is None and trial.string_onset is None:
            statement = "neither hand nor string leaves its place"
            remedy = "It carries little information: leave it out"
            yield warning(dataset.hand_file, "t", statement, remedy, trial.name)
