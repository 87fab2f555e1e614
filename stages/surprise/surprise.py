"""Test of a trial against the predictions that were made before it.

The measured path of the tip and those predicted by samples of the posterior are
compared as one set. If the trial comes from the model, the measured path is one more
sample, and each rank of its distance is equally likely: the p-value is exact, whatever
the distance (a Monte Carlo test; Besag and Clifford, Biometrika 78, 301, 1991).
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from stringcast.data.artifacts import SURPRISE_SUMMARY, Motion, Points, Surprise
from stringcast.stages.common import MM_PER_M
from stringcast.stages.spec import StageCall

ALARM_P_VALUE = 0.02  # share of false alarms
MIN_DRAWS = 50  # fewer cannot show so small a share
MIN_FRAMES = 5  # fewer readings of the tip show nothing
MIN_SPREAD_M = 5e-4  # of predictions and noise together: rounding is no surprise


def run(call: StageCall, motion: Motion, points: Points) -> Surprise:
    """Test the trial of an iteration against its predictions, as a stage."""
    return measure_surprise(motion, points, np.random.default_rng(call.seed))


def measure_surprise(
    motion: Motion, points: Points, rng: np.random.Generator
) -> Surprise:
    """Test whether the measured tip is within what the samples predicted.

    Parameters
    ----------
    motion : Motion
        The motion, with the tips that samples predict.
    points : Points
        What was read from the frames.
    rng : numpy.random.Generator
        Of the noise that predictions of measurements have.

    Returns
    -------
    Surprise
        The p-value; NaN where there is nothing to compare.
    """
    readings = points.readings
    is_moving = readings["t"].between(0, motion.duration)
    read = readings[readings["valid"].astype(bool) & is_moving]
    draws = motion.tips["draw"].nunique()
    if draws < MIN_DRAWS:
        return _describe(draws, len(read), "Nothing was predicted before this cast.")
    if len(read) < MIN_FRAMES:
        sentence = "Too few frames were read to compare the tip with its prediction."
        return _describe(draws, len(read), sentence)

    t = read["t"].to_numpy()
    measured = read[["tip_x", "tip_y"]].to_numpy()  # (F, 2)
    sigma = read["tip_sigma"].to_numpy()  # (F,)
    predicted = predicted_tips_at(motion.tips, t)  # (K, F, 2)
    noise = rng.standard_normal(predicted.shape) * sigma[:, None]
    distances = path_distances(np.concatenate([measured[None], predicted + noise]))
    as_far = int((distances[1:] >= distances[0]).sum())
    p_value = (1 + as_far) / (1 + draws)
    apart_m = np.linalg.norm(measured - np.median(predicted, axis=0), axis=-1)
    sentence = (
        f"The tip was up to {MM_PER_M * apart_m.max():.0f} mm from its predicted path; "
        f"{as_far} of {draws} predictions lie as far from the others "
        f"(p = {p_value:.2f})."
    )
    is_surprising = p_value <= ALARM_P_VALUE
    sentence += " The trial is a surprise." if is_surprising else ""
    return _describe(
        draws, len(read), sentence, float(distances[0]), p_value, is_surprising
    )


def predicted_tips_at(tips: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """Interpolate the predicted tips at times (F,) [s], (K, F, 2) [m]."""
    times = np.sort(tips["t"].unique())
    paths = tips.sort_values(["draw", "t"])[["x", "y"]].to_numpy()
    paths = paths.reshape(-1, len(times), 2)
    return np.asarray(CubicSpline(times, paths, axis=1)(t))


def path_distances(paths: np.ndarray) -> np.ndarray:
    """Measure how far each of K paths (K, F, 2) lies from all, over their spread, (K,).

    Mean and spread are those of all K paths together, so that no path is special.
    """
    mean = paths.mean(axis=0)
    spread = np.sqrt(paths.var(axis=0).sum(axis=-1) + MIN_SPREAD_M**2)  # (F,)
    apart = np.linalg.norm(paths - mean, axis=-1) / spread
    return np.asarray(np.sqrt(np.mean(apart**2, axis=1)))


def _describe(
    draws: int,
    frames: int,
    sentence: str,
    distance: float = np.nan,
    p_value: float = np.nan,
    surprising: bool = False,
) -> Surprise:
    row = {
        "draws": draws,
        "frames": frames,
        "distance": distance,
        "p_value": p_value,
        "surprising": surprising,
        "sentence": sentence,
    }
    return Surprise(SURPRISE_SUMMARY.check(pd.DataFrame([row])))
