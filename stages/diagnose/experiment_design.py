"""The motion that would tell look-alikes apart: of many random ones, that with the
largest expected log odds.

Each rival may move its parameters as far as the trials made allow, and may lack as much
as it does there. To first order in these the log odds of the true one over another, on
one more trial, are normal with mean m, variance 2 m:

    m = 1/2 d' (V + J N^(-1) J')^(-1) d,        d what the rivals differ by, J the other's slopes, N what is known of it

All motions are compared by d alone; the most promising with what the rivals could do
about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from stringcast.data.artifacts import COMMANDS, CONTROL_POINTS, PREDICTED_STRINGS
from stringcast.stages.diagnose.candidate_motions import (
    DesignSettings,
    points_represented,
    sample_motions_within_limits,
    synthetic_trial,
)
from stringcast.stages.diagnose.discretisation import subtract_discretisation_error
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.generate import command_table, control_point_table
from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.inference.likelihood import PRIOR_PRECISION
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.box import Box
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.parameter import parameter_values

MAX_COMPARED_MOTIONS = 24  # motions of which it is asked what rivals could do


@dataclass(frozen=True)
class ProposedExperiment:
    """next_experiment: as in diagnosis.json, None where nothing is left to be decided.
    The motion's tables, and where each rival has the string in it; all empty where no
    motion would help.
    """

    next_experiment: Mapping[str, Any] | None = None
    commands: pd.DataFrame = field(default_factory=COMMANDS.empty)
    control_points: pd.DataFrame = field(default_factory=CONTROL_POINTS.empty)
    predicted: pd.DataFrame = field(default_factory=PREDICTED_STRINGS.empty)


@dataclass(frozen=True)
class Rivals:
    """Hypotheses that stand against one another, the likeliest first, by what differs
    in them. data: the trials made. enough: log odds that decide.
    """

    fits: Mapping[str, Fit]
    data: TrialData
    deciding_log_odds: float

    def expected_log_odds(
        self, trial: TrialData
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Expected log odds (R, R) of each rival, if it is true, over each other in a
        further trial; and what each would show at its points as near to the likeliest
        as it can come, (2 n,) over sigma.
        """
        size = int(np.median(next(iter(self.fits.values())).scale_indices))
        shown, slopes = {}, {}
        for name, fit in self.fits.items():
            offset = np.where(
                fit.chi > 0.5, -solver.FIRST_DIFFERENCE, solver.FIRST_DIFFERENCE
            )
            many = trial.residuals(
                fit.hypothesis.model,
                np.concatenate([fit.chi[None], fit.chi + np.diag(offset)]),
            )[0]
            if (many == solver.DIVERGED_RESIDUAL).any():
                return np.zeros((len(self.fits), len(self.fits))), {}
            shown[name], slopes[name] = many[0], (many[1:] - many[0]) / offset[:, None]
        names, one = list(self.fits), np.array([size])
        odds, near = (
            np.full((len(names), len(names)), np.inf),
            {names[0]: shown[names[0]]},
        )
        for a, b in (
            (a, b) for a in range(len(names)) for b in range(len(names)) if a != b
        ):
            apart = shown[names[b]] - shown[names[a]]
            d, j = (
                trial.whiten([each], one) for each in (apart[None], slopes[names[b]])
            )
            step = -np.linalg.solve(
                self._parameter_information(names[b]) + j @ j.T, j @ d[0]
            )
            odds[a, b] = 0.5 * float(d[0] @ (d[0] + step @ j))
            if a == 0:
                near[names[b]] = shown[names[b]] + step @ slopes[names[b]]
        return odds, near

    def _parameter_information(self, name: str) -> np.ndarray:
        """What the trials made tell of a rival's parameters, (P, P)."""
        fit = self.fits[name]
        white = self.data.for_hypothesis(fit.hypothesis).whiten(
            fit.slopes, fit.scale_indices
        )
        return np.asarray(white @ white.T + PRIOR_PRECISION * np.eye(len(fit.chi)))


def design_experiment(
    rivals: Rivals,
    obstacles: Sequence[Box],
    design: DesignSettings,
    rng: np.random.Generator,
) -> ProposedExperiment:
    """The motion to perform next, and what it will do; nothing where one hypothesis
    stands alone or the arm is unknown.
    """
    if len(rivals.fits) < 2 or not all(
        isinstance(t.motion, JointMotion) for t in rivals.data.trials
    ):
        return ProposedExperiment()
    likeliest = next(iter(rivals.fits.values()))
    curves = sample_motions_within_limits(
        likeliest.hypothesis.base, obstacles, design, rng
    )
    if not len(curves.duration):
        return ProposedExperiment()
    like = max(rivals.data.trials, key=lambda trial: len(trial.s))
    cases = [
        _candidate_trial(likeliest.hypothesis, curves, i, like, design)
        for i in range(len(curves.duration))
    ]
    few = _most_different_motions(rivals, cases, obstacles)
    tried = {
        i: rivals.expected_log_odds(
            subtract_discretisation_error(
                [cases[i]], likeliest.hypothesis, likeliest.chi
            )[0]
        )
        for i in few
    }
    best = max(few, key=lambda i: tried[i][0].min(), default=None)
    if best is None:
        return ProposedExperiment()
    odds, near = tried[best]
    text = _experiment_document(rivals, odds, len(cases))
    if odds.min() < 1:
        return ProposedExperiment(text)
    curve = curves.select(np.array([best]))
    arm = likeliest.hypothesis.model.arm
    return ProposedExperiment(
        text,
        command_table(arm, curve),
        control_point_table(curve),
        _predicted_table(cases[best], near),
    )


def _candidate_trial(
    hypothesis: Hypothesis,
    curves: Curves,
    number: int,
    like: PreparedTrial,
    design: DesignSettings,
) -> PreparedTrial:
    """The trial that a motion would make, each point as certain as those it stands for."""
    case = synthetic_trial(
        hypothesis.model, curves.select(np.array([number])), like, design
    )
    return replace(
        case,
        sigma=case.sigma
        / np.sqrt(max(points_represented(hypothesis.model, case, like), 1.0)),
    )


def _most_different_motions(
    rivals: Rivals, cases: Sequence[PreparedTrial], obstacles: Sequence[Box]
) -> list[int]:
    """Motions on which the rivals as they were fitted differ most, none of those in
    which the string touches an obstacle or cannot be simulated.
    """
    seen = []
    for fit in rivals.fits.values():
        values = parameter_values(fit.hypothesis.parameters, fit.chi[None])
        seen.append(
            [
                points[0]
                for points in simulate_trials(fit.hypothesis.model, cases, values)
            ]
        )
    apart = np.array(
        [
            _min_mean_square_difference([each[i] for each in seen])
            for i in range(len(cases))
        ]
    )
    struck = [
        any(bool(box.is_crossed_by(p[:, :-1], p[:, 1:]).any()) for box in obstacles)
        for p in seen[0]
    ]
    allowed = np.flatnonzero(np.isfinite(apart) & ~np.array(struck))
    return [
        int(i)
        for i in allowed[np.argsort(-apart[allowed], kind="stable")][
            :MAX_COMPARED_MOTIONS
        ]
    ]


def _min_mean_square_difference(strings: Sequence[np.ndarray]) -> float:
    """The least mean square by which two of several strings (F, n, 2) differ over a
    motion [m2].
    """
    return float(min(np.mean((a - b) ** 2) for a, b in combinations(strings, 2)))


def _odds_summary(odds: float, enough: float) -> dict[str, float]:
    """Log odds of this mean, and twice that variance, and the probability that they
    exceed what decides.
    """
    decide = float(norm.cdf((odds - enough) / np.sqrt(2 * max(odds, 1e-12))))
    numbers = {
        "probability_to_decide": decide,
        "expected_log_odds": odds,
        "spread": float(np.sqrt(2 * odds)),
    }
    return {name: round(value, 3) for name, value in numbers.items()}


def _experiment_document(
    rivals: Rivals, odds: np.ndarray, count: int
) -> dict[str, Any]:
    """next_experiment, but for the place where the motion will be."""
    made = [
        float(rivals.expected_log_odds(rivals.data.subset([k]))[0].min())
        for k in range(len(rivals.data.trials))
    ]
    again = int(np.argmax(made))
    old = {
        "trial": rivals.data.trials[again].name,
        **_odds_summary(made[again], rivals.deciding_log_odds),
    }
    found, names = (
        _odds_summary(float(odds.min()), rivals.deciding_log_odds),
        list(rivals.fits),
    )
    pairs = combinations(range(len(names)), 2)
    alike = [[names[a], names[b]] for a, b in pairs if min(odds[a, b], odds[b, a]) < 1]
    text = {
        "sentence": _experiment_sentence(
            names, alike, found, old, count, rivals.deciding_log_odds
        ),
        "between": names,
    }
    return (
        text
        | found
        | {"already_performed": old, "inseparable": alike, "motions_compared": count}
    )


def _experiment_sentence(
    names: Sequence[str],
    alike: Sequence[Sequence[str]],
    found: Mapping[str, float],
    old: Mapping[str, Any],
    count: int,
    enough: float,
) -> str:
    pairs = "; ".join(" and ".join(pair) for pair in alike)
    if alike:
        return f"Of {count} motions within the arm's limits none tells all of them apart; on the best, alike stay {pairs}."
    return (
        f"Of {count} motions within the arm's limits, one tells {', '.join(names)} apart with a probability of "
        f"{found['probability_to_decide']:.2f} (expected log odds {found['expected_log_odds']:.1f}, spread "
        f"{found['spread']:.1f}; {enough:.1f} decides). Trial {old['trial']} made once more would with "
        f"{old['probability_to_decide']:.2f}."
    )


def _predicted_table(
    case: PreparedTrial, shown: Mapping[str, np.ndarray]
) -> pd.DataFrame:
    """Table PREDICTED_STRINGS."""
    frames = []
    for name, each in shown.items():
        x, y = (case.points + each.reshape(-1, 2) * case.sigma[:, None]).T
        table = {
            "hypothesis": name,
            "t": case.times[case.frame],
            "s": case.s,
            "x": x,
            "y": y,
            "sigma": case.sigma,
        }
        frames.append(pd.DataFrame(table))
    return PREDICTED_STRINGS.check(pd.concat(frames, ignore_index=True))
