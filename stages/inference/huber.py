"""Huber's loss (1964): quadratic within a limit and linear beyond it."""

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
    """Compute weights (..., N) whose weighted squares have the slope of the loss.

    They are 1 within the limit and less beyond it.
    """
    size = np.maximum(np.abs(residual), np.finfo(float).tiny)
    return np.asarray(np.minimum(1.0, limit / size))
