"""The choice of the frames of a trial that are used."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.data.trial_faults import MIN_FRAMES
from stringcast.stages.inference.basis import (
    KNOT_SPACING_S,
    LOW_FREQUENCY_HZ,
    highest_frequency,
    time_nodes,
)
from stringcast.stages.inference.likelihood import MOTION_SHARE
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.string_places import track_places

KEPT_REST_S = 0.2  # of a string at rest
# Per spline of the discrepancy, as in a second at 240 Hz
FRAMES_PER_SPLINE = 4

log = logging.getLogger(__name__)


def trim_trailing_rest(trial: PreparedTrial) -> PreparedTrial:
    """Cut the end of a trial in which the string hangs still.

    Many frames of rest have no more information than a few, but would have more weight.
    """
    times = trial.times
    distance = np.zeros(len(times))  # of each frame from the final rest [m]
    is_late = trial.point_times > times[-1] - KEPT_REST_S
    for track in track_places(trial.frame, trial.s):
        late = track[is_late[track]]
        if late.size:
            rest = np.median(trial.points[late], axis=0)
            track_distance = np.linalg.norm(trial.points[track] - rest, axis=1)
            np.maximum.at(distance, trial.frame[track], track_distance)
    moving = np.flatnonzero(distance > MOTION_SHARE * trial.model.string.length)
    last = times[moving[-1]] if moving.size else times[0]
    return trial.cut_after(max(last + KEPT_REST_S, times[:MIN_FRAMES][-1]))


def thin_frames(trial: PreparedTrial) -> PreparedTrial:
    """Keep every m-th frame of a long trial.

    A longer trial has a wider knot spacing of the discrepancy. More frames per knot
    determine little more, and cost time and memory.
    """
    splines = len(time_nodes(trial.times, KNOT_SPACING_S))
    step = len(trial.times) // (FRAMES_PER_SPLINE * splines)
    if step < 2:
        return trial
    thinned = trial.select_points(trial.frame % step == 0)
    return replace(
        thinned,
        times=trial.times[::step],
        frame=thinned.frame // step,
        growth=trial.growth[::step],
    )


def warn_of_long_trials(trials: Sequence[PreparedTrial]) -> None:
    """Log the frequency up to which misfit is resolved in long trials."""
    for trial in trials:
        if len(trial.times) < 2:
            continue
        frequency_hz = highest_frequency(trial.times)
        if frequency_hz < LOW_FREQUENCY_HZ:
            log.warning(
                "trial %s lasts %.1f s: misfit is followed up to %.0f Hz there, in %d "
                "frames; split it into trials of 2 s to see faster misfit",
                trial.name,
                np.ptp(trial.times),
                frequency_hz,
                len(trial.times),
            )
