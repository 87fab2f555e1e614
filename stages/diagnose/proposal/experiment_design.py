"""The motion that would best distinguish look-alikes.

It is the one of many random motions with the largest expected log odds. The parameters
of each rival are uncertain by as much as the measured trials leave them, and its
discrepancy has the size and the time course that are typical of these. To first order,
the log odds of the true rival over another in one more trial are normal with mean m and
variance 2 m:

    m = 1/2 d' (V + J I^(-1) J')^(-1) d

d is the difference of the rivals, J the slopes of the other one, I the information of
the measured trials about its parameters, and V the covariance of noise and discrepancy.
All motions are first compared by d, then the best of them by m. Rivals whose tips
differ by no more than the unexplained misfit of the measured trials remain look-alikes,
because they share their probability (`single_effect`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, permutations
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from stringcast.data.artifacts import COMMANDS, CONTROL_POINTS
from stringcast.data.diagnoses import PREDICTED_STRINGS
from stringcast.stages.common import describe_causes, rms
from stringcast.stages.diagnose.evidence.linearisation import LinearisedFit
from stringcast.stages.diagnose.evidence.measures import unexplained_tip_rms
from stringcast.stages.diagnose.proposal.candidate_motions import (
    DesignSettings,
    sample_motions_within_limits,
    synthetic_trial,
    with_represented_points,
)
from stringcast.stages.diagnose.rules import remainder_hides
from stringcast.stages.diagnose.trials.discretisation import (
    subtract_discretisation_error,
)
from stringcast.stages.generate.generate import command_table, control_point_table
from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.discrepancy_grid import typical_grid_point
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.parameter import parameter_values

MAX_COMPARED_MOTIONS = 24
INSEPARABLE_LOG_ODDS = 1.0  # two rivals with less remain look-alikes


@dataclass(frozen=True)
class ProposedExperiment:
    """The motion to perform next, empty if none would help.

    Attributes
    ----------
    next_experiment : dict or None
        As in diagnosis.json; None if nothing is left to decide.
    commands, control_points, predicted : pandas.DataFrame
        The motion, and the string as each rival predicts it.
    """

    next_experiment: Mapping[str, Any] | None = None
    commands: pd.DataFrame = field(default_factory=COMMANDS.empty)
    control_points: pd.DataFrame = field(default_factory=CONTROL_POINTS.empty)
    predicted: pd.DataFrame = field(default_factory=PREDICTED_STRINGS.empty)


@dataclass(frozen=True)
class Rivals:
    """Hypotheses that explain the measured trials about equally well.

    Attributes
    ----------
    fits : dict
        Fits by name of the cause that differs, the likeliest first.
    data : TrialData
        The measured trials.
    """

    fits: Mapping[str, Fit]
    data: TrialData
    deciding_log_odds: float

    @cached_property
    def remainder_m(self) -> float:
        """The tips' unexplained misfit by the likeliest rival, root mean square [m]."""
        likeliest = next(iter(self.fits.values()))
        return rms(unexplained_tip_rms(self.data, likeliest))

    @cached_property
    def informations(self) -> list[np.ndarray]:
        """Information of the measured trials about each rival's parameters, (P, P)."""
        return [LinearisedFit(self.data, f).information for f in self.fits.values()]

    def expected_log_odds(
        self,
        trial: TrialData,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Compute the expected log odds of the rivals in one further trial.

        Returns
        -------
        log_odds : numpy.ndarray, shape (R, R)
            Log odds of each rival, if it is true, over each other.
        predicted : dict of numpy.ndarray, shape (2 n,)
            Points of each rival over sigma, with parameters that imitate the likeliest
            best.
        """
        names = list(self.fits)
        fits = list(self.fits.values())
        count = len(fits)
        grid_points = np.array([typical_grid_point(fits[0].grid_points)])
        residuals = []  # (2 n,) of each rival
        slopes = []  # (P, 2 n)
        for fit in fits:
            chi, offset = solver.difference_exponents(fit.chi, solver.FIRST_DIFFERENCE)
            simulated = trial.residuals(fit.hypothesis.model, chi)[0]
            if (simulated == solver.DIVERGED_RESIDUAL).any():
                return np.zeros((count, count)), {}
            residuals.append(simulated[0])
            slopes.append((simulated[1:] - simulated[0]) / offset[:, None])

        log_odds = np.full((count, count), np.inf)
        predicted = {names[0]: residuals[0]}
        for true, other in permutations(range(count), 2):
            # The parameters of the other rival imitate the true one by a step
            difference = residuals[other] - residuals[true]  # (2 n,)
            white = trial.whiten([difference[None]], grid_points)[0]  # (N,)
            white_slopes = trial.whiten([slopes[other]], grid_points)  # (P, N)
            normal = self.informations[other] + white_slopes @ white_slopes.T
            step = -np.linalg.solve(normal, white_slopes @ white)
            nearest = residuals[other] + step @ slopes[other]

            # White d' times the rest is m (Woodbury identity)
            remainder = white + step @ white_slopes
            log_odds[true, other] = 0.5 * float(white @ remainder)
            difference_m = trial.tip_rms_by_trial([nearest - residuals[true]])
            if remainder_hides(float(difference_m[0]), self.remainder_m):
                log_odds[true, other] = 0.0
            if true == 0:
                predicted[names[other]] = nearest
        return log_odds, predicted


def design_experiment(
    rivals: Rivals,
    obstacles: Sequence[Box],
    design: DesignSettings,
    rng: np.random.Generator,
) -> ProposedExperiment:
    """Design the motion to perform next.

    None is proposed if there is only one hypothesis or the arm's joints are unknown.
    """
    measured = rivals.data.trials
    has_joints = all(isinstance(trial.motion, JointMotion) for trial in measured)
    if len(rivals.fits) < 2 or not has_joints:
        return ProposedExperiment()
    likeliest = next(iter(rivals.fits.values()))
    hypothesis = likeliest.hypothesis
    curves = sample_motions_within_limits(hypothesis.base, obstacles, design, rng)
    like = max(measured, key=lambda trial: len(trial.s))
    trials = []
    for number in range(len(curves.duration)):
        curve = curves.select(np.array([number]))
        trial = synthetic_trial(hypothesis.model, curve, like, design)
        trials.append(with_represented_points(trial, like))

    best = -1
    best_odds = np.zeros(0)
    best_predicted = dict[str, np.ndarray]()
    for number in _most_different_motions(rivals, trials, obstacles):
        data, _ = subtract_discretisation_error(
            [trials[number]], hypothesis, likeliest.chi
        )
        log_odds, predicted = rivals.expected_log_odds(data)
        if best < 0 or log_odds.min() > best_odds.min():
            best = number
            best_odds = log_odds
            best_predicted = predicted
    if best < 0:
        return ProposedExperiment()
    document = _experiment_document(rivals, best_odds, len(trials))
    if best_odds.min() < INSEPARABLE_LOG_ODDS:
        return ProposedExperiment(document)
    curve = curves.select(np.array([best]))
    return ProposedExperiment(
        document,
        command_table(hypothesis.model.arm, curve),
        control_point_table(curve),
        _predicted_table(trials[best], best_predicted),
    )


def _most_different_motions(
    rivals: Rivals,
    trials: Sequence[PreparedTrial],
    obstacles: Sequence[Box],
) -> list[int]:
    """Select the motions in which the fitted rivals differ most.

    Motions are left out if the likeliest string crosses an obstacle or any simulation
    diverges.
    """
    if not trials:
        return []
    by_rival = []
    for fit in rivals.fits.values():
        values = parameter_values(fit.hypothesis.parameters, fit.chi[None])
        by_rival.append(simulate_trials(fit.hypothesis.model, trials, values))
    differences = []
    crosses = []
    for strings in zip(*by_rival, strict=True):  # (1, F, n, 2) of each rival
        squares = [np.mean((a[0] - b[0]) ** 2) for a, b in combinations(strings, 2)]
        differences.append(float(min(squares)))
        likeliest = strings[0][0]
        inner = likeliest[:, :-1]
        outer = likeliest[:, 1:]
        crossed = [box.is_crossed_by(inner, outer).any() for box in obstacles]
        crosses.append(any(crossed))
    difference = np.array(differences)
    allowed = np.flatnonzero(np.isfinite(difference) & ~np.array(crosses))
    order = np.argsort(-difference[allowed], kind="stable")
    return [int(number) for number in allowed[order][:MAX_COMPARED_MOTIONS]]


def _odds_summary(log_odds: float, deciding: float) -> dict[str, float]:
    """Summarise normal log odds with a given mean and twice that variance."""
    deviation = np.sqrt(2 * max(log_odds, 1e-12))
    probability = float(ndtr((log_odds - deciding) / deviation))
    return {
        "probability_to_decide": round(probability, 3),
        "expected_log_odds": round(log_odds, 3),
        "spread": round(float(np.sqrt(2 * log_odds)), 3),
    }


def _experiment_document(
    rivals: Rivals,
    log_odds: np.ndarray,
    motions: int,
) -> dict[str, Any]:
    """Build next_experiment of diagnosis.json, without the motion's folder."""
    names = list(rivals.fits)
    deciding = rivals.deciding_log_odds
    data = rivals.data
    repeated = []
    for k in range(len(data.trials)):
        repeated_odds, _ = rivals.expected_log_odds(data.subset([k]))
        repeated.append(float(repeated_odds.min()))
    best = int(np.argmax(repeated))
    inseparable = []
    for a, b in combinations(range(len(names)), 2):
        if min(log_odds[a, b], log_odds[b, a]) < INSEPARABLE_LOG_ODDS:
            inseparable.append([names[a], names[b]])
    summary = _odds_summary(float(log_odds.min()), deciding)
    repeated_name = data.trials[best].name
    repeated_summary = _odds_summary(repeated[best], deciding)

    sentence = f"Of {motions} motions within the arm's limits, "
    if inseparable:
        pairs = "; ".join(describe_causes(pair) for pair in inseparable)
        sentence += (
            "none distinguishes all of them; the best one does not distinguish "
            f"{pairs}."
        )
    else:
        between = describe_causes(names)
        sentence += (
            f"one distinguishes {between} with a probability of "
            f"{summary['probability_to_decide']:.2f}; repeating trial "
            f"{repeated_name} does so with "
            f"{repeated_summary['probability_to_decide']:.2f}."
        )
    return {
        "sentence": sentence,
        "between": names,
        **summary,
        "already_performed": {"trial": repeated_name, **repeated_summary},
        "inseparable": inseparable,
        "motions_compared": motions,
    }


def _predicted_table(
    trial: PreparedTrial,
    predicted: Mapping[str, np.ndarray],
) -> pd.DataFrame:
    """Build the table PREDICTED_STRINGS."""
    frames = []
    for name, residual in predicted.items():
        points = trial.points + trial.displacements_m(residual)
        table = {
            "hypothesis": name,
            "t": trial.point_times,
            "s": trial.s,
            "x": points[:, 0],
            "y": points[:, 1],
            "sigma": trial.sigma,
        }
        frames.append(pd.DataFrame(table))
    return PREDICTED_STRINGS.check(pd.concat(frames, ignore_index=True))
