"""Test of a trial against what the estimate before it predicts.

The measured path of the tip and those predicted by samples of the posterior are
compared as one set. If the trial comes from the model, the measured path is one more
sample, and each rank of its distance is equally likely: the p-value is exact, whatever
the distance (a Monte Carlo test; Besag and Clifford, Biometrika 78, 301, 1991).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import (
    SURPRISE_SUMMARY,
    Estimate,
    Motion,
    Observation,
    Points,
    Surprise,
    Trial,
)
from stringcast.stages.common import MM_PER_M
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.extension import extend_model
from stringcast.stages.spec import StageCall
from stringcast.stages.surprise.prediction import predict_tips

ALARM_P_VALUE = 0.02  # share of false alarms
MIN_DRAWS = 50  # fewer cannot show so small a share
MIN_FRAMES = 5  # fewer readings of the tip show nothing
MIN_SPREAD_M = 5e-4  # of predictions and noise together: rounding is no surprise


def run(
    call: StageCall,
    motion: Motion,
    trial: Trial,
    points: Points,
    last_motion: Motion | None,
    estimate: Estimate | None,
) -> Surprise:
    """Test the trial of an iteration against what was known before it, as a stage."""
    if not motion.is_cast or estimate is None or estimate.draws.empty:
        return describe_missing_test("Nothing was known of the string before.")
    readings = points.readings
    is_moving = readings["t"].between(0, motion.duration)
    read = readings[readings["valid"].astype(bool) & is_moving]
    if len(read) < MIN_FRAMES:
        return describe_missing_test(
            "Too few frames were read to compare the tip with its prediction."
        )

    rng = np.random.default_rng(call.seed)
    model = extend_model(call.setup.model, estimate.values())
    observation = Observation(
        "", points.points, points.readings, points.masks, arm=trial.arm
    )
    prepared = prepare_trial(model, observation)
    prepared = replace(prepared, times=read["t"].to_numpy())
    predicted = predict_tips(prepared, motion, last_motion, estimate, rng)
    measured = read[["tip_x", "tip_y"]].to_numpy()
    return measure_surprise(predicted, measured, read["tip_sigma"].to_numpy(), rng)


def measure_surprise(
    predicted: np.ndarray,
    measured: np.ndarray,
    sigma: np.ndarray,
    rng: np.random.Generator,
) -> Surprise:
    """Test whether the measured tip is within what samples predict.

    Parameters
    ----------
    predicted : (K, F, 2) array
        Tips that samples predict [m].
    measured : (F, 2) array
        Tips that were read [m].
    sigma : (F,) array
        Noise of a measured coordinate [m].
    rng : numpy.random.Generator
        Of the noise that predictions of measurements have.

    Returns
    -------
    Surprise
        The p-value; NaN with too few samples.
    """
    draws = len(predicted)
    if draws < MIN_DRAWS:
        return describe_missing_test("Too few samples could be simulated.")
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
        draws, len(measured), sentence, float(distances[0]), p_value, is_surprising
    )


def describe_missing_test(reason: str) -> Surprise:
    """Build the artifact of a trial that was not tested."""
    return _describe(0, 0, reason)


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
