"""Outcomes of a sweep's jobs, and the uncertainty of their means over the seeds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtrit

from stringcast.stages.common import readable_name

CONFIDENCE = 0.95  # of the intervals of means and rates
# fewer values have no interval, because Student's is then wider than prior knowledge
MIN_SEEDS = 5
MeanFunction = Callable[[np.ndarray], tuple[float, float, float]]


def arithmetic_mean(values: np.ndarray) -> tuple[float, float, float]:
    """Return mean and Student's 95 % interval of (K,) values, NaN for a single one."""
    mean = float(values.mean())
    if len(values) < 2:
        return mean, np.nan, np.nan
    quantile = stdtrit(len(values) - 1, (1 + CONFIDENCE) / 2)
    half = float(quantile * values.std(ddof=1) / np.sqrt(len(values)))
    return mean, mean - half, mean + half


def geometric_mean(values: np.ndarray) -> tuple[float, float, float]:
    """Return geometric mean and 95 % interval of (K,) positive values.

    Suitable for values that span powers of ten.
    """
    mean, low, high = np.exp(arithmetic_mean(np.log(values)))
    return float(mean), float(low), float(high)


def mean_share(values: np.ndarray) -> tuple[float, float, float]:
    """Return mean and Wilson's 95 % interval (1927) of (K,) shares.

    Each value counts as one trial. If values are means over several jobs of a seed, the
    interval is too wide.
    """
    mean = float(values.mean())
    count = len(values)
    z = float(ndtri((1 + CONFIDENCE) / 2))
    added = z**2 / count  # weight of the prior mean of one half
    middle = (mean + added / 2) / (1 + added)
    variance = mean * (1 - mean) / count + (added / (2 * z)) ** 2
    half = z * float(np.sqrt(variance)) / (1 + added)
    return mean, middle - half, middle + half


@dataclass(frozen=True)
class Outcome:
    """A column of the sweep's table.

    label, unit: of an axis. mean: combines the values of several seeds. scale: factor
    from the column's unit to the axis' unit. axis: Matplotlib's name of its scale.
    bounds: least and largest possible value, in the column's unit.
    """

    name: str
    label: str
    unit: str
    mean: MeanFunction
    scale: float = 1.0
    axis: str = "linear"
    bounds: tuple[float, float] = (0.0, np.inf)

    def mean_over_seeds(self, values: np.ndarray) -> np.ndarray:
        """Return mean and interval of the seeds' values (K,), in the axis' unit.

        The interval is NaN for fewer than MIN_SEEDS values.
        """
        mean, low, high = self.mean(values)
        if len(values) < MIN_SEEDS:
            low, high = np.nan, np.nan
        interval = np.clip([low, high], *self.bounds)
        return np.array([mean, *interval]) * self.scale

    @property
    def title(self) -> str:
        """Label of the outcome with its unit in brackets."""
        return self.label if self.unit in ("", "1") else f"{self.label} [{self.unit}]"


CAST_OUTCOMES = (
    Outcome("hit", "hit rate", "%", mean_share, scale=100.0, bounds=(0.0, 1.0)),
    Outcome("casts", "casts", "", arithmetic_mean, bounds=(1.0, np.inf)),
    Outcome("E_after", "matching rate E", "", arithmetic_mean, bounds=(0.0, 1.0)),
    Outcome("miss_m", "closest approach", "mm", arithmetic_mean, scale=1e3),
)


def parameter_outcome(name: str, unit: str) -> Outcome:
    """Describe an estimated parameter as an outcome on a logarithmic scale."""
    return Outcome(name, readable_name(name), unit, geometric_mean, axis="log")


def mean_response(
    jobs: pd.DataFrame, outcome: Outcome, factors: list[str]
) -> pd.DataFrame:
    """Average an outcome of finished jobs at each level of some settings.

    Returns columns factors, mean, low, high, seeds, jobs. Levels without a known value
    have no row; levels with fewer than MIN_SEEDS seeds have no interval.
    """
    has_value = jobs[outcome.name].notna()
    if outcome.axis == "log":
        has_value &= jobs[outcome.name] > 0
    rows = []
    for level, at_level in jobs[has_value].groupby(factors, sort=True):
        values = at_level.groupby("seed")[outcome.name].mean().to_numpy(float)
        interval = outcome.mean_over_seeds(values)
        rows.append([*level, *interval, len(values), len(at_level)])
    columns = [*factors, "mean", "low", "high", "seeds", "jobs"]
    return pd.DataFrame(rows, columns=columns)
