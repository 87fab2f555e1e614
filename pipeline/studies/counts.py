"""Shares that studies count, with their intervals, in tables and as bars."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from stringcast.data.schema import Column

COUNTS = (
    Column("right", "1", "how many of them", "int"),
    Column("count", "1", "of how many", "int"),
    Column("share", "1", "right over count"),
    Column("low", "1", "lower end of the 95 % interval (Clopper and Pearson)"),
    Column("high", "1", "upper end"),
)
UNKNOWN_CODE = "unknown"  # of rows of studies that were begun before they said so


def counted(right: pd.Series) -> dict[str, float]:
    """A count, its total, their ratio and its exact 95 % interval: the columns COUNTS."""
    n, k = len(right), int(right.sum())
    if n == 0:
        return {"right": 0, "count": 0, "share": np.nan, "low": 0.0, "high": 1.0}
    interval = binomtest(k, n).proportion_ci(0.95, method="exact")
    return {
        "right": k,
        "count": n,
        "share": k / n,
        "low": interval.low,
        "high": interval.high,
    }


def bars(some: pd.DataFrame) -> np.ndarray:
    """Distances of the intervals' ends from the shares, (2, K), as error bars are
    drawn. some: with COUNTS.
    """
    return np.abs(some[["low", "high"]].to_numpy().T - some["share"].to_numpy())
