"""Predictions of trials by fits that have not seen them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stringcast.data.artifacts import HELD_OUT, Observation
from stringcast.stages.estimate.matching import Matching, matching_targets
from stringcast.stages.inference.discrepancy import (
    best_scale_index,
    marginal_log_likelihood,
)
from stringcast.stages.inference.initial_modes import with_initial_states_at
from stringcast.stages.inference.laplace import Fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

RATED_FRAMES = 20  # of a trial, from which the matching rate is counted


@dataclass(frozen=True)
class Prediction:
    """Prediction of a trial by a fit that has not seen it.

    Attributes
    ----------
    fit : Fit
        To the other trials.
    residual : numpy.ndarray, shape (2 n,)
        Predicted minus measured points over sigma.
    log_likelihood : float
        Of the trial.
    """

    fit: Fit
    residual: np.ndarray
    log_likelihood: float


def predict_trials(data: TrialData, fit: Fit) -> list[Prediction]:
    """Predict trials by a fit that has seen none of them."""
    return [_predict_trial(data, fit, k) for k in range(len(data.trials))]


def predict_left_out_trials(data: TrialData, fit: Fit) -> list[Prediction]:
    """Predict each trial by a fit of the same hypothesis to the others."""
    numbers = range(len(data.trials))
    predictions = []
    for number in numbers:
        others = data.subset([k for k in numbers if k != number])
        # The discrepancy scale of the trial left out is not known: start from the
        # median
        scales = np.full(len(others.trials), int(np.median(fit.scale_indices)))
        refit = fit_hypothesis(others, fit.hypothesis, fit.chi[None], scales)
        predictions.append(_predict_trial(data, refit, number))
    return predictions


def _predict_trial(data: TrialData, fit: Fit, number: int) -> Prediction:
    trial = with_initial_states_at(data.subset([number]), fit).for_hypothesis(
        fit.hypothesis
    )
    residuals = trial.residuals(fit.hypothesis.model, fit.chi[None])
    log_likelihoods = trial.log_likelihood_by_scale(residuals)[:, 0]
    (residual,) = trial.without_nuisance(
        [residuals[0][0]], best_scale_index(log_likelihoods)
    )
    return Prediction(fit, residual, float(marginal_log_likelihood(log_likelihoods)[0]))


def held_out_table(
    data: TrialData,
    base: Sequence[Prediction],
    extended: Sequence[Prediction],
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
    for number, trial in enumerate(data.trials):
        row: dict[str, object] = {"trial": trial.name}
        row["log_likelihood_difference"] = gains[number]
        row["noise_floor"] = float(np.sqrt(2 * np.mean(trial.sigma**2)))
        for name, predictions in (("base", base), ("extended", extended)):
            one = predictions[number]
            model = one.fit.hypothesis.model
            chi = one.fit.chi
            row |= rms_distances(trial, one.residual, name)
            row[f"E_{name}"] = matching_rate(
                model, chi, trial, observations[number], matching
            )
        residual = _predict_trial(data, known, number).residual
        row["rms_known"] = rms_distances(trial, residual, "known")["rms_known"]
        rows.append(row)
    return HELD_OUT.check(pd.DataFrame(rows)) if rows else HELD_OUT.empty()


def log_likelihood_gains(
    base: Sequence[Prediction], extended: Sequence[Prediction]
) -> np.ndarray:
    """Gain of each trial's log-likelihood by the extended model's prediction, (K,)."""
    pairs = zip(base, extended, strict=True)
    return np.array([more.log_likelihood - less.log_likelihood for less, more in pairs])


def improves_predictions(
    base: Sequence[Prediction], extended: Sequence[Prediction]
) -> bool:
    """Whether the extended model is closer to the trials, and makes them likelier."""
    squares = []
    log_likelihoods = []
    for predictions in (base, extended):
        squares.append(sum(float(np.sum(p.residual**2)) for p in predictions))
        log_likelihoods.append(sum(p.log_likelihood for p in predictions))
    return squares[1] < squares[0] and log_likelihoods[1] > log_likelihoods[0]


def rms_distances(
    trial: PreparedTrial, residual: np.ndarray, name: str
) -> dict[str, float]:
    """Compute root mean squares [m] of a residual over sigma, of all and tip points.

    The keys end with a name.
    """
    distance = np.linalg.norm(residual.reshape(-1, 2), axis=1) * trial.sigma
    return {
        f"rms_{name}": float(np.sqrt(np.mean(distance**2))),
        f"tip_rms_{name}": float(np.sqrt(np.mean(distance[trial.is_tip] ** 2))),
    }


def matching_rate(
    model: Model,
    chi: np.ndarray,
    trial: PreparedTrial,
    observation: Observation,
    matching: Matching,
) -> float:
    """Compute the matching rate E (Eq. 5) from a prepared trial's initial state."""
    target = matching_targets(model, [thin_frames(observation)], matching)[0]
    case = replace(target.trial, initial_state=trial.initial_state, turn=trial.turn)
    target = replace(target, trial=case)
    return float(
        np.mean(target.rates_by_frame(parameter_values(model.parameters, chi[None]))[0])
    )


def thin_frames(observation: Observation) -> Observation:
    """Keep some RATED_FRAMES frames of an observation.

    They are too far apart to estimate the initial state from.
    """
    points = observation.valid_points
    times = np.unique(points["t"])
    kept = times[:: max(len(times) // RATED_FRAMES, 1)]
    return replace(
        observation, points=points[points["t"].isin(kept)], starts_moving=False
    )
