"""Predictions of trials by fits that have not seen them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import Observation
from stringcast.data.diagnoses import HELD_OUT
from stringcast.stages.common import rms
from stringcast.stages.diagnose.evidence.left_out_fits import (
    exponents_without_groups,
    groups_to_leave_out,
)
from stringcast.stages.estimate.matching import (
    Matching,
    MatchingTarget,
    matching_targets,
)
from stringcast.stages.inference.discrepancy_grid import (
    marginal_log_likelihood,
    most_likely_grid_point,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import with_initial_states_at
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

RATED_FRAMES = 20  # of each trial, for the matching rate


@dataclass(frozen=True)
class TrialPrediction:
    """Prediction of a trial by a fit that has not seen it.

    Attributes
    ----------
    chi : numpy.ndarray, shape (P,)
        Exponents that were fitted to other trials.
    residual : numpy.ndarray, shape (2 n,)
        Predicted minus measured points over sigma.
    log_likelihood : float
        Log-likelihood of the trial.
    """

    hypothesis: Hypothesis
    chi: np.ndarray
    residual: np.ndarray
    log_likelihood: float


def predict_trials(data: TrialData, fit: Fit) -> list[TrialPrediction]:
    """Predict trials by a fit that has seen none of them."""
    hypothesis = fit.hypothesis
    restarted = with_initial_states_at(data, fit)
    trials = restarted.for_hypothesis(hypothesis)
    residuals = trials.residuals(hypothesis.model, fit.chi[None])
    by_grid_point = trials.log_likelihood_by_grid_point(residuals)[:, 0]  # (K, W S)
    grid_points = most_likely_grid_point(by_grid_point)
    rest = trials.without_nuisance([rows[0] for rows in residuals], grid_points)
    log_likelihoods = marginal_log_likelihood(by_grid_point).tolist()
    predictions = []
    for residual, log_likelihood in zip(rest, log_likelihoods, strict=True):
        prediction = TrialPrediction(hypothesis, fit.chi, residual, log_likelihood)
        predictions.append(prediction)
    return predictions


def predict_left_out_trials(data: TrialData, fit: Fit) -> list[TrialPrediction]:
    """Predict each trial by a fit of the same hypothesis to other trials.

    From nine trials on, they are left out in eight groups.
    """
    groups = groups_to_leave_out(len(data.trials))
    predictions: dict[int, TrialPrediction] = {}
    exponents = exponents_without_groups(data, fit, groups)
    for group, chi in zip(groups, exponents, strict=True):
        # Only the exponents of the fit to the others are needed
        predicted = predict_trials(data.subset(group), replace(fit, chi=chi))
        predictions |= zip(group, predicted, strict=True)
    return [predictions[k] for k in range(len(data.trials))]


def held_out_table(
    data: TrialData,
    base: Sequence[TrialPrediction],
    extended: Sequence[TrialPrediction],
    known: Fit,
    observations: Sequence[Observation],
    matching: Matching,
) -> pd.DataFrame:
    """Build the table HELD_OUT.

    Parameters
    ----------
    base, extended : sequence of Prediction, length K
    known : Fit
        The extended model fitted to all trials from which causes were selected.
    observations : sequence of Observation, length K
    """
    rows = []
    gains = log_likelihood_gains(base, extended)
    by_known = predict_trials(data, known)
    model = known.hypothesis.model
    for number, trial in enumerate(data.trials):
        target = matching_target(model, trial, observations[number], matching)
        row: dict[str, object] = {
            "trial": trial.name,
            "log_likelihood_difference": gains[number],
            "noise_floor": np.sqrt(2 * np.mean(trial.sigma**2)),
        }
        for name, predictions in (("base", base), ("extended", extended)):
            prediction = predictions[number]
            rms_m, tip_rms_m = rms_distances(trial, prediction.residual)
            row |= {f"rms_{name}": rms_m, f"tip_rms_{name}": tip_rms_m}
            row[f"E_{name}"] = matching_rate(target, prediction)
        row["rms_known"], _ = rms_distances(trial, by_known[number].residual)
        rows.append(row)
    return HELD_OUT.check(pd.DataFrame(rows))


def log_likelihood_gains(
    base: Sequence[TrialPrediction],
    extended: Sequence[TrialPrediction],
) -> np.ndarray:
    """Gain of each trial's log-likelihood by the extended model's prediction, (K,)."""
    pairs = zip(base, extended, strict=True)
    return np.array(
        [after.log_likelihood - before.log_likelihood for before, after in pairs]
    )


def improves_predictions(
    base: Sequence[TrialPrediction],
    extended: Sequence[TrialPrediction],
) -> bool:
    """Return whether the extended model predicts the median trial better.

    A sum over trials would be dominated by a badly predicted one.
    """
    ratios = []
    for before, after in zip(base, extended, strict=True):
        ratios.append(rms(after.residual) / rms(before.residual))
    gains = log_likelihood_gains(base, extended)
    return bool(np.median(ratios) < 1 and np.median(gains) > 0)


def tip_errors(
    data: TrialData,
    predictions: Sequence[TrialPrediction],
) -> np.ndarray:
    """Compute the root mean square error at the tip of each trial [m], (K,)."""
    errors_m = []
    for trial, prediction in zip(data.trials, predictions, strict=True):
        _, tip_rms_m = rms_distances(trial, prediction.residual)
        errors_m.append(tip_rms_m)
    return np.array(errors_m)


def rms_distances(trial: PreparedTrial, residual: np.ndarray) -> tuple[float, float]:
    """Compute root mean squares [m] of a residual over sigma, of all and tip points."""
    distance = np.linalg.norm(residual.reshape(-1, 2), axis=1) * trial.sigma
    return rms(distance), rms(distance[trial.is_tip])


def matching_target(
    model: Model,
    trial: PreparedTrial,
    observation: Observation,
    matching: Matching,
) -> MatchingTarget:
    """Rasterise some frames of a trial for the matching rate."""
    (target,) = matching_targets(model, [with_rated_frames(observation)], matching)
    state = trial.initial_state
    thinned = replace(target.trial, initial_state=state, turn=trial.turn)
    return replace(target, trial=thinned)


def matching_rate(target: MatchingTarget, prediction: TrialPrediction) -> float:
    """Compute the matching rate E (Eq. 5) of a prediction on the target's mesh."""
    model = prediction.hypothesis.model
    values = parameter_values(model.parameters, prediction.chi[None])
    predicted = replace(target, trial=replace(target.trial, model=model))
    return float(np.mean(predicted.rates_by_frame(values)[0]))


def with_rated_frames(observation: Observation) -> Observation:
    """Keep about RATED_FRAMES frames of an observation.

    They are too far apart to estimate an initial state.
    """
    points = observation.valid_points
    times = np.unique(points["t"])
    kept = times[:: max(len(times) // RATED_FRAMES, 1)]
    return replace(
        observation, points=points[points["t"].isin(kept)], starts_moving=False
    )
