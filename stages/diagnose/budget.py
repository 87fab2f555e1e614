"""The error budget: what each cause, the numerical error, noise and the unknown are of
the misfit at the tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stringcast.stages.diagnose.forward_selection import SelectionState, refit
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, sample_discrepancy_tip_rms


@dataclass(frozen=True)
class BudgetEntry:
    """One source. tip_rms: root mean square at the tip over all trials [m];
    log_evidence: what is lost without a cause, NaN of what is none.
    """

    source: str
    tip_rms_m: float
    log_evidence: float = float("nan")


@dataclass(frozen=True)
class ErrorBudget:
    """entries: whose squares add up to the square of the base model's misfit at the
    tip. unexplained: value and 95 % interval of what is left [m]. by_cause: the fits
    with the first causes, none first.
    """

    entries: tuple[BudgetEntry, ...]
    unexplained_m: tuple[float, float, float]
    nested_fits: tuple[Fit, ...]


def error_budget(
    found: SelectionState, base: Fit, rng: np.random.Generator
) -> ErrorBudget:
    """Causes share in the order in which they entered. What is left of the misfit
    beside noise and numerical error, as these are known, is unexplained. base: the base
    model's fit to the same data.
    """
    data, fits = found.prepared.data, nested_fits(found, base)
    begun = [
        data.for_hypothesis(fit.hypothesis).without_initial_state_error(
            fit.residuals, fit.scale_indices
        )
        for fit in fits
    ]
    # [m2], over trials
    squares = np.minimum.accumulate(
        [np.mean(data.tip_rms_by_trial(each) ** 2) for each in begun]
    )
    noise, numerical = _noise_and_numerical_mean_squares(found.prepared)
    left = float(squares[-1])
    numerical = min(numerical, left)
    noise = min(noise, left - numerical)
    names, full = found.fit.hypothesis.cause_names, fits[-1]
    lost = [
        full.log_evidence
        - refit(data, full, full.hypothesis.without_cause(c)).log_evidence
        for c in full.hypothesis.causes
    ]
    shares = squares[:-1] - squares[1:]  # of what explains nothing 0, not -0
    entries = [
        BudgetEntry(n, float(np.sqrt(s)), e)
        for n, s, e in zip(names, shares, lost, strict=True)
    ]
    rest = [
        ("numerical error", numerical),
        ("noise", noise),
        ("unexplained", left - numerical - noise),
    ]
    entries += [
        BudgetEntry(name, float(np.sqrt(max(square, 0.0)))) for name, square in rest
    ]
    drawn = np.sqrt(np.mean(sample_discrepancy_tip_rms(data, full, rng) ** 2, axis=0))
    low, high = np.quantile(drawn, [0.025, 0.975]).tolist()
    value = entries[-1].tip_rms_m
    ends = (value, min(low, value), max(high, value))
    return ErrorBudget(tuple(entries), ends, tuple(fits))


def nested_fits(found: SelectionState, base: Fit) -> list[Fit]:
    """The fits with no cause, with the first, and so on, to the same data."""
    data, full = found.prepared.data, found.fit
    if not full.hypothesis.causes:
        return [full]
    some = [full.hypothesis.causes[:k] for k in range(1, len(full.hypothesis.causes))]
    between = [
        refit(data, full, Hypothesis(full.hypothesis.base, causes)) for causes in some
    ]
    return [base, *between, full]


def _noise_and_numerical_mean_squares(prepared: PreparedData) -> tuple[float, float]:
    """Mean squares at the tip that noise, and what is in doubt of the numerical error,
    leave [m2].
    """
    noise = [
        2 * np.mean(trial.sigma[trial.is_tip] ** 2) for trial in prepared.data.trials
    ]
    return float(np.mean(noise)), float(
        np.mean(prepared.discretisation_uncertainty_m**2)
    )
