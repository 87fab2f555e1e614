"""Test a trial against the prediction of the estimate before it.

The measured path of the tip and those predicted by draws of the posterior form one set.
If the trial comes from the model, the measured path is one more draw, and each rank of
its distance is equally likely. The p-value is then exact for any distance measure (a
Monte Carlo test; Besag and Clifford, Biometrika 78, 301, 1991).

The distance is measured from the most similar paths, with their covariance. It detects
a small deviation that no parameters produce, even if the predictions spread widely. The
test ends at the planned hit: later frames are irrelevant, and small differences grow
there beyond what draws and mesh resolve.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Motion, Observation, Points, Trial
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import SURPRISE_SUMMARY, Surprise
from stringcast.stages.common import MM_PER_M
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.extension import extend_model
from stringcast.stages.spec import StageCall
from stringcast.stages.surprise.prediction import predict_tips

ALARM_P_VALUE = 0.02  # share of false alarms
NEIGHBOURS = 50  # most similar paths; several times the number of parameters
MIN_DRAWS = 2 * NEIGHBOURS  # fewer draws would all share their neighbours
MIN_FRAMES = 5  # fewer readings of the tip are too few to test
MIN_SIGMA_M = 5e-4  # least noise of a coordinate, above rounding


def run(
    call: StageCall,
    motion: Motion,
    trial: Trial,
    points: Points,
    last_motion: Motion | None,
    estimate: Estimate | None,
) -> Surprise:
    """Test the trial of an iteration against the estimate before it."""
    if not motion.is_cast or estimate is None or estimate.draws.empty:
        return describe_missing_test("There was no estimate of the string before.")
    readings = points.readings
    is_before_hit = readings["t"].between(0, motion.outcome["t_hit"].iloc[0])
    read = readings[readings["valid"].astype(bool) & is_before_hit]
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
    """Test whether the measured tip agrees with the predictions.

    Parameters
    ----------
    predicted : (K, F, 2) array
        Predicted tips, one path per draw [m].
    measured : (F, 2) array
        Measured tips [m].
    sigma : (F,) array
        Noise of a measured coordinate [m].
    rng : numpy.random.Generator
        Source of the measurement noise that is added to predictions.

    Returns
    -------
    Surprise
        The p-value; NaN with too few draws.
    """
    draws = len(predicted)
    if draws < MIN_DRAWS:
        return describe_missing_test("Too few strings could be simulated.")
    noise = rng.standard_normal(predicted.shape) * sigma[:, None]
    paths = np.concatenate([measured[None], predicted + noise])
    distances = distances_from_neighbours(paths, sigma)
    as_unusual = int((distances[1:] >= distances[0]).sum())
    p_value = (1 + as_unusual) / (1 + draws)
    offset_m = np.linalg.norm(measured - np.median(predicted, axis=0), axis=-1)
    is_surprising = p_value <= ALARM_P_VALUE
    conclusion = "a surprise" if is_surprising else "no surprise"
    sentence = (
        f"Until the planned hit, the tip was up to {MM_PER_M * offset_m.max():.0f} mm "
        f"from its predicted path. Of {draws} paths simulated with possible strings, "
        f"{as_unusual} are as unusual: the trial is {conclusion} (p = {p_value:.2g})."
    )
    return _describe(
        draws, len(measured), sentence, float(distances[0]), p_value, is_surprising
    )


def describe_missing_test(reason: str) -> Surprise:
    """Build the artifact of a trial that was not tested."""
    return _describe(0, 0, reason)


def distances_from_neighbours(paths: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Measure how far each of K paths (K, F, 2) lies from the most similar ones, (K,).

    This is the Mahalanobis distance from the nearest NEIGHBOURS, with their covariance
    plus that of the noise sigma (F,) [m]; noise alone gives 1 per coordinate. All paths
    are treated alike.
    """
    scaled = paths / np.maximum(sigma, MIN_SIGMA_M)[:, None]
    scaled = scaled.reshape(len(paths), -1)  # (K, 2 F)
    squares = np.sum(scaled**2, axis=1)
    square_distances = squares[:, None] + squares - 2 * scaled @ scaled.T
    np.fill_diagonal(square_distances, np.inf)
    nearest = np.argpartition(square_distances, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS]

    distances = np.empty(len(paths))
    for number, path in enumerate(scaled):
        neighbours = scaled[nearest[number]]
        mean = neighbours.mean(axis=0)
        offset = path - mean
        spread = (neighbours - mean) / np.sqrt(NEIGHBOURS)
        # the inverse of 1 + spread' spread, by the matrix inversion lemma
        along = spread @ offset
        kernel = np.eye(NEIGHBOURS) + spread @ spread.T
        square = offset @ offset - along @ np.linalg.solve(kernel, along)
        distances[number] = np.sqrt(square / len(path))
    return distances


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
