"""Marks on the string may be elsewhere than stated: what that does to measured points.

A ruler along a string that is not quite straight, or a tracker's idea of where its
points are, is off by a millimetre. Every mark is then seen as far along the string,
frame after frame, which no noise does, and which shifts of the camera or of the clamp
do as well. The grasp and the tip are where they are; between them the error is a sum of
a few half waves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.inference.batch import measured_points
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.model import Model
from stringcast.stages.string_places import track_places

PLACE_ERROR_M = 1e-3  # standard deviation of each half wave
MAX_HALF_WAVES = 3
STEP_M = 1e-3  # of the arc length, over which points are differenced


def mark_place_columns(
    trials: Sequence[PreparedTrial],
    model: Model,
    values: np.ndarray,
) -> list[np.ndarray]:
    """Compute how points move over sigma with each half wave, (2 N, M) of each trial.

    There are as many as marks between the grasp and the tip, and MAX_HALF_WAVES at
    most; zeros for what cannot be simulated.

    Parameters
    ----------
    values : numpy.ndarray, shape (P,)
        Parameters of the model.
    """
    length = model.string.length
    nearer = []
    for trial in trials:
        nearer.append(replace(trial, s=np.maximum(trial.s - STEP_M, 0.0)))
    simulated = zip(
        trials,
        measured_points(model, trials, values[None]),
        measured_points(model, nearer, values[None]),
        strict=True,
    )
    columns = []
    for trial, points, nearer_points in simulated:
        step = np.minimum(STEP_M, np.maximum(trial.s, 1e-9))
        slope = np.nan_to_num((points[0] - nearer_points[0]) / step[:, None])
        half_waves = np.arange(1, count_marks(trial, length) + 1)
        shifts = PLACE_ERROR_M * np.sin(np.pi * trial.s[:, None] / length * half_waves)
        moved = slope[:, :, None] * shifts[:, None, :]  # (N, 2, M)
        scaled = moved / trial.sigma[:, None, None]
        columns.append(scaled.reshape(2 * len(trial.s), -1))
    return columns


def count_marks(trial: PreparedTrial, length: float) -> int:
    """Count the half waves that the places of a trial's points tell apart."""
    between = 0
    for track in track_places(trial.frame, trial.s):
        place = float(np.median(trial.s[track]))
        between += STEP_M < place < length - STEP_M
    return min(between, MAX_HALF_WAVES)
