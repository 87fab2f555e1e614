"""Huber's loss: squares within a limit, and straight lines beyond it, so that outliers
count less (Huber 1964).
"""

from __future__ import annotations

import numpy as np

HUBER_LIMIT = 2.0  # standard deviations: 98.9 % efficient on normal noise


def huber_loss(residual: np.ndarray, limit: float) -> np.ndarray:
    """Mean over the last axis, (...): the mean square where nothing is beyond the
    limit. residual: (..., N).
    """
    size = np.abs(residual)
    within = np.minimum(size, limit)
    return np.asarray(np.mean(within * (2 * size - within), axis=-1))


def huber_weights(residual: np.ndarray, limit: float) -> np.ndarray:
    """With which squares have the same slope as the loss, (..., N): 1 within the limit,
    less beyond.
    """
    return np.minimum(1.0, limit / np.maximum(np.abs(residual), np.finfo(float).tiny))
