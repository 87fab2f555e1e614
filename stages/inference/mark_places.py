"""Displacements of points by wrong arc lengths of the marks on the string.

Arc lengths from a ruler or a tracker have errors of about a millimetre. The points of
such a mark are displaced along the string in every frame. Noise does not do that, but a
shifted camera or clamp does: without this model, the diagnosis would find one. The
error is zero at the grasp and at the tip. Between them it is a sum of a few half waves.
Each trial has its own errors, although marks do not move between trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.model import Model
from stringcast.stages.string_places import track_places

PLACE_ERROR_M = 1e-3  # standard deviation of each half wave
MAX_HALF_WAVES = 3
STEP_M = 1e-3  # arc length of the finite difference


def mark_place_columns(
    trials: Sequence[PreparedTrial],
    model: Model,
    values: np.ndarray,
) -> list[np.ndarray]:
    """Compute the displacement of points by each half wave, over sigma.

    Parameters
    ----------
    values : numpy.ndarray, shape (P,)
        Parameters of the model.

    Returns
    -------
    list of numpy.ndarray, shape (2 N, M)
        Columns of each trial; zeros if its simulation diverges.
    """
    length = model.string.length
    counts = [count_half_waves(trial, length) for trial in trials]
    if not any(counts):
        return [np.zeros((2 * len(trial.s), 0)) for trial in trials]
    strings = simulate_trials(model, trials, values[None])
    columns = []
    for trial, count, string in zip(trials, counts, strings, strict=True):
        tangents = _tangents(trial, string)
        half_waves = np.arange(1, count + 1)
        shifts = PLACE_ERROR_M * np.sin(np.pi * trial.s[:, None] / length * half_waves)
        moved = tangents[:, :, None] * shifts[:, None, :]  # (N, 2, M)
        scaled = moved / trial.sigma[:, None, None]
        columns.append(scaled.reshape(2 * len(trial.s), -1))
    return columns


def _tangents(trial: PreparedTrial, string: np.ndarray) -> np.ndarray:
    """Compute tangents of a simulated string (1, F, n, 2) at each point, (N, 2)."""
    nearer = replace(trial, s=np.maximum(trial.s - STEP_M, 0.0))
    step = np.minimum(STEP_M, np.maximum(trial.s, 1e-9))
    moved = trial.sample_at_points(string)[0] - nearer.sample_at_points(string)[0]
    return np.asarray(np.nan_to_num(moved / step[:, None]))


def count_half_waves(trial: PreparedTrial, length: float) -> int:
    """Count the half waves that a trial's points can distinguish.

    It is the number of marks between grasp and tip, at most MAX_HALF_WAVES.
    """
    between = 0
    for track in track_places(trial.frame, trial.s):
        place = float(np.median(trial.s[track]))
        between += STEP_M < place < length - STEP_M
    return min(between, MAX_HALF_WAVES)
