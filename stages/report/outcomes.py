"""Results of a job, and the uncertainty of their mean over the seeds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm, t

CONFIDENCE = 0.95  # of the intervals of means and rates
Mean = Callable[[np.ndarray], tuple[float, float, float]]


def average(values: np.ndarray) -> tuple[float, float, float]:
    """Mean and its 95 % interval by Student's t, NaN where there is one value only.
    values: (K,).
    """
    mean = float(values.mean())
    if len(values) < 2:
        return mean, np.nan, np.nan
    half = (
        t.ppf((1 + CONFIDENCE) / 2, len(values) - 1)
        * values.std(ddof=1)
        / np.sqrt(len(values))
    )
    return mean, float(mean - half), float(mean + half)


def magnitude(values: np.ndarray) -> tuple[float, float, float]:
    """Geometric mean and its 95 % interval, for what spans powers of ten. values: (K,),
    positive.
    """
    mean, low, high = np.exp(average(np.log(values)))
    return float(mean), float(low), float(high)


def share(values: np.ndarray) -> tuple[float, float, float]:
    """Mean of shares and its 95 % interval by Wilson (1927), each of the (K,) values
    counting as one throw.

    Where a value is itself a mean over several jobs of a seed, the interval is rather
    too wide than too narrow.
    """
    mean, count, z = (
        float(values.mean()),
        len(values),
        float(norm.ppf((1 + CONFIDENCE) / 2)),
    )
    middle = (mean + z**2 / (2 * count)) / (1 + z**2 / count)
    half = (
        z
        / (1 + z**2 / count)
        * np.sqrt(mean * (1 - mean) / count + z**2 / (4 * count**2))
    )
    return mean, float(middle - half), float(middle + half)


@dataclass(frozen=True)
class Outcome:
    """A column of the sweep's table. label, unit: as written at an axis. scale: what
    its numbers are multiplied by there. mean: how values of several seeds are joined.
    axis: matplotlib's name of the axis' scale.
    """

    name: str
    label: str
    unit: str
    mean: Mean
    scale: float = 1.0
    axis: str = "linear"

    @property
    def title(self) -> str:
        """Label and unit."""
        return (
            f"{self.label} [{self.unit}]" if self.unit not in ("", "1") else self.label
        )


OUTCOMES = (
    Outcome("hit", "hit rate", "%", share, scale=100.0),
    Outcome("manipulations", "manipulations", "", average),
    Outcome("E_after", "matching rate E", "", average),
    Outcome("miss_m", "closest approach", "mm", average, scale=1e3),
)


def parameter(name: str, unit: str, meaning: str) -> Outcome:
    """A parameter that was estimated, on a scale of powers of ten."""
    return Outcome(name, name.replace("_", " "), unit, magnitude, axis="log")


def response(jobs: pd.DataFrame, outcome: Outcome, factors: list[str]) -> pd.DataFrame:
    """Mean of an outcome at each level of some factors: columns factors, mean, low,
    high, seeds, jobs.

    jobs: those that ended, with a column `seed`. Levels at which nothing is known have
    no row.
    """
    known = jobs[
        jobs[outcome.name].notna()
        & ((jobs[outcome.name] > 0) | (outcome.axis != "log"))
    ]
    rows = []
    for level, some in known.groupby(factors, sort=True):
        values = some.groupby("seed")[outcome.name].mean().to_numpy(float)
        mean, low, high = np.array(outcome.mean(values)) * outcome.scale
        place = dict(zip(factors, level, strict=True))
        rows.append(
            place
            | {
                "mean": mean,
                "low": low,
                "high": high,
                "seeds": len(values),
                "jobs": len(some),
            }
        )
    return pd.DataFrame(
        rows, columns=[*factors, "mean", "low", "high", "seeds", "jobs"]
    )
