"""How fast something swings."""

import numpy as np


def frequency(t: np.ndarray, x: np.ndarray) -> float:
    """Return the mean frequency [rad/s] from rising zero crossings, interpolated."""
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossing = t[up] - x[up] * (t[up + 1] - t[up]) / (x[up + 1] - x[up])
    return 2 * np.pi * (len(crossing) - 1) / (crossing[-1] - crossing[0])
