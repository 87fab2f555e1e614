"""Huber's loss: squares within a limit and straight lines beyond it.

Outliers then count less (Huber 1964).
"""

from __future__ import annotations

import numpy as np

HUBER_LIMIT = 2.0  # standard deviations: 98.9 % efficient on normal noise


def huber_loss(residual: np.ndarray, limit: float) -> np.ndarray:
    """Average the loss of residuals (..., N) over the last axis, (...).

    It is the mean square where no residual exceeds the limit.
    """
    size = np.abs(residual)
    within = np.minimum(size, limit)
    loss = within * (2 * size - within)
    return np.asarray(np.mean(loss, axis=-1))


def huber_weights(residual: np.ndarray, limit: float) -> np.ndarray:
    """Compute the weights (..., N) by which squares have the slope of the loss.

    They are 1 within the limit and less beyond it.
    """
    size = np.maximum(np.abs(residual), np.finfo(float).tiny)
    return np.asarray(np.minimum(1.0, limit / size))
