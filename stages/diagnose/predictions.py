"""Base and extended model on trials left out of the fit."""

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

RATED_FRAMES = 20  # of a trial, from which E is counted


@dataclass(frozen=True)
class Prediction:
    """One trial as a fit to others has it. fit: that. residual: over sigma, (2 n,).
    log_likelihood: of the trial.
    """

    fit: Fit
    residual: np.ndarray
    log_likelihood: float


def predict_trials(data: TrialData, fit: Fit, unseen: bool = False) -> list[Prediction]:
    """Each trial of the data by a fit that has not seen it: by this one if all are
    unseen, or by one to the others.
    """
    numbers = range(len(data.trials))
    if unseen:
        return [_predict_trial(data, fit, number) for number in numbers]
    found = []
    for number in numbers:
        others = data.subset([k for k in numbers if k != number])
        # those of the trial left out are in none
        sizes = np.full(len(others.trials), int(np.median(fit.scale_indices)))
        found.append(
            _predict_trial(
                data,
                fit_hypothesis(others, fit.hypothesis, fit.chi[None], sizes),
                number,
            )
        )
    return found


def _predict_trial(data: TrialData, fit: Fit, number: int) -> Prediction:
    own = with_initial_states_at(data.subset([number]), fit).for_hypothesis(
        fit.hypothesis
    )
    residuals = own.residuals(fit.hypothesis.model, fit.chi[None])
    told = own.log_likelihood_by_scale(residuals)[:, 0]
    (residual,) = own.without_initial_state_error(
        [residuals[0][0]], best_scale_index(told)
    )
    return Prediction(fit, residual, float(marginal_log_likelihood(told)[0]))


def held_out_table(
    data: TrialData,
    base: Sequence[Prediction],
    extended: Sequence[Prediction],
    known: Fit,
    observations: Sequence[Observation],
    matching: Matching,
) -> pd.DataFrame:
    """Table HELD_OUT. known: the extended model fitted to all that causes were chosen
    from.
    """
    rows = []
    for number, (plain, more, rise) in enumerate(
        zip(base, extended, log_likelihood_gains(base, extended), strict=True)
    ):
        trial = data.trials[number]
        row: dict[str, object] = {
            "trial": trial.name,
            "log_likelihood_difference": rise,
        }
        row["noise_floor"] = float(np.sqrt(2 * np.mean(trial.sigma**2)))
        for name, one in (("base", plain), ("extended", more)):
            row |= rms_distances(trial, one.residual, name)
            row[f"E_{name}"] = matching_rate(
                one.fit.hypothesis.model,
                one.fit.chi,
                trial,
                observations[number],
                matching,
            )
        own = _predict_trial(data, known, number).residual
        rows.append(
            row | {"rms_known": rms_distances(trial, own, "known")["rms_known"]}
        )
    return HELD_OUT.check(pd.DataFrame(rows)) if rows else HELD_OUT.empty()


def log_likelihood_gains(
    base: Sequence[Prediction], extended: Sequence[Prediction]
) -> np.ndarray:
    """By how much likelier each trial is by the extended model's predictions than by
    the base's, (K,).
    """
    return np.array(
        [
            m.log_likelihood - p.log_likelihood
            for p, m in zip(base, extended, strict=True)
        ]
    )


def predicts_better(base: Sequence[Prediction], extended: Sequence[Prediction]) -> bool:
    """Whether the extended model predicts the trials better, by its distance from them
    and by its likelihood.
    """
    squares = [
        sum(float(np.sum(p.residual**2)) for p in side) for side in (base, extended)
    ]
    said = [sum(p.log_likelihood for p in side) for side in (base, extended)]
    return squares[1] < squares[0] and said[1] > said[0]


def rms_distances(
    trial: PreparedTrial, residual: np.ndarray, name: str
) -> dict[str, float]:
    """Root mean squares of a trial's residual over sigma, of all of it and of the tip
    [m].
    """
    off = np.linalg.norm(residual.reshape(-1, 2), axis=1) * trial.sigma
    parts = {"rms": off, "tip_rms": off[trial.is_tip]}
    return {
        f"{what}_{name}": float(np.sqrt(np.mean(part**2)))
        for what, part in parts.items()
    }


def matching_rate(
    model: Model,
    chi: np.ndarray,
    trial: PreparedTrial,
    observation: Observation,
    matching: Matching,
) -> float:
    """Matching rate E (Eq. 5) of an observation that begins as a trial does."""
    goal = matching_targets(model, [thin_frames(observation)], matching)[0]
    goal = replace(
        goal,
        trial=replace(goal.trial, initial_state=trial.initial_state, turn=trial.turn),
    )
    return float(
        np.mean(goal.rates_by_frame(parameter_values(model.parameters, chi[None]))[0])
    )


def thin_frames(observation: Observation) -> Observation:
    """With some FRAMES frames, which are too far apart to tell how it begins: that is
    not asked of them.
    """
    points = observation.valid_points
    times = np.unique(points["t"])
    kept = times[:: max(len(times) // RATED_FRAMES, 1)]
    return replace(
        observation, points=points[points["t"].isin(kept)], starts_moving=False
    )
