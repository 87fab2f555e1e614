"""Error bars of shares that studies count."""

from __future__ import annotations

import numpy as np
import pandas as pd


def error_bars(shares: pd.DataFrame) -> np.ndarray:
    """Return distances of the interval ends from the shares, (2, K).

    Matplotlib draws error bars from them.
    """
    ends = shares[["low", "high"]].to_numpy().T
    return np.abs(ends - shares["share"].to_numpy())
