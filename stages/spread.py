"""How widely numbers scatter, whatever a few of them do."""

from __future__ import annotations

import numpy as np

NORMAL = 1.4826  # standard deviation over median magnitude, of a normal distribution


def spread(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Robust standard deviation about zero, of all values (...) or along an axis, from their median magnitude."""
    return NORMAL * np.asarray(np.median(np.abs(values), axis=axis), dtype=float)
