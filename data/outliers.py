"""Single samples of a motion that are wrong: nothing that has mass goes away and comes back within two samples."""

from __future__ import annotations

import numpy as np
import pandas as pd

LEAST = 2e-3  # [m] or [rad] by which a sample must be off
CLEAR = 10.0  # times as much as is usual about it
AROUND = 11  # samples
BACK = 0.25  # of a spike, by which its neighbours must seem off the other way: of a real motion they are not


def outliers(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Whether each sample is an outlier, (K,) bool. t: (K,) increasing times [s]. values: (K, J), continuous."""
    found = np.zeros(len(t), dtype=bool)
    if len(t) < 5:
        return found
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off = values[1:-1] - values[:-2] - share[:, None] * (values[2:] - values[:-2])
    usual = pd.DataFrame(np.abs(off)).rolling(AROUND, center=True, min_periods=1).median().to_numpy()[1:-1]
    here, before, after = off[1:-1], off[:-2], off[2:]
    back = (before * here < -BACK * here**2) & (after * here < -BACK * here**2)
    found[2:-2] = (back & (np.abs(here) > np.maximum(LEAST, CLEAR * usual))).any(axis=1)
    return found
