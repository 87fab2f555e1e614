"""The error budget: how much each source moves the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.diagnose.evidence.measures import (
    refit,
    residuals_without_nuisance,
)
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, sample_discrepancy_tip_rms


@dataclass(frozen=True)
class BudgetEntry:
    """Source of misfit at the tip, with its size.

    Attributes
    ----------
    tip_rms_m : float
        Root mean square at the tip over all trials [m].
    log_evidence : float
        Loss of log evidence without the cause; NaN if the source is not a cause.
    """

    source: str
    tip_rms_m: float
    log_evidence: float = float("nan")


@dataclass(frozen=True)
class ErrorBudget:
    """The base model's misfit at the tip by its sources.

    Attributes
    ----------
    entries : tuple of BudgetEntry
        Their squares add up to the square of the misfit.
    unexplained_m : tuple of float
        Value and 95 % interval of the unexplained rest [m].
    nested_fits : tuple of Fit
        Fits with no cause, with the first, and so on.
    """

    entries: tuple[BudgetEntry, ...]
    unexplained_m: tuple[float, float, float]
    nested_fits: tuple[Fit, ...]


def error_budget(
    state: SelectionState,
    base: Fit,
    rng: np.random.Generator,
) -> ErrorBudget:
    """Divide the base model's misfit among causes, numerical error, noise and the rest.

    Causes are added in the order of acceptance. The unexplained part is the remaining
    misfit without noise and the uncertainty of numerical error.
    """
    data = state.prepared.data
    fits = nested_fits(state, base)
    mean_squares = []  # [m2], over trials
    for fit in fits:
        residuals = residuals_without_nuisance(data, fit)
        mean_squares.append(np.mean(data.tip_rms_by_trial(residuals) ** 2))
    squares = np.minimum.accumulate(mean_squares)
    shares = squares[:-1] - squares[1:]  # of causes; np.diff would give -0

    entries = []
    full = fits[-1]
    for number, cause in enumerate(full.hypothesis.causes):
        without = refit(data, full, full.hypothesis.without_cause(cause))
        lost = full.log_evidence - without.log_evidence
        share_m = float(np.sqrt(shares[number]))
        entries.append(BudgetEntry(cause.name, share_m, lost))

    remaining = float(squares[-1])
    noise, numerical = _noise_and_numerical_mean_squares(state.prepared)
    numerical = min(numerical, remaining)
    noise = min(noise, remaining - numerical)
    rest = {
        "numerical error": numerical,
        "noise": noise,
        "unexplained": remaining - numerical - noise,
    }
    for name, square in rest.items():
        entries.append(BudgetEntry(name, float(np.sqrt(max(square, 0.0)))))

    value = entries[-1].tip_rms_m
    draws_m = sample_discrepancy_tip_rms(data, full, rng)  # (K, draws)
    samples = np.sqrt(np.mean(draws_m**2, axis=0))
    low, high = np.quantile(samples, [0.025, 0.975]).tolist()
    interval = (value, min(low, value), max(high, value))
    return ErrorBudget(tuple(entries), interval, tuple(fits))


def nested_fits(state: SelectionState, base: Fit) -> list[Fit]:
    """Fit no cause, the first cause, the first two, and so on, to the same data."""
    data = state.prepared.data
    full = state.fit
    causes = full.hypothesis.causes
    if not causes:
        return [full]
    fits = [base]
    for count in range(1, len(causes)):
        hypothesis = Hypothesis(full.hypothesis.base, causes[:count])
        fits.append(refit(data, full, hypothesis))
    return [*fits, full]


def _noise_and_numerical_mean_squares(prepared: PreparedData) -> tuple[float, float]:
    """Mean squares at the tip of noise and of uncertain numerical error [m2]."""
    noise = []
    for trial in prepared.data.trials:
        noise.append(2 * np.mean(trial.sigma[trial.is_tip] ** 2))
    uncertainty_m = prepared.discretisation_uncertainty_m
    known_m = uncertainty_m[np.isfinite(uncertainty_m)]
    numerical = np.mean(known_m**2) if known_m.size else 0.0
    return float(np.mean(noise)), float(numerical)
