"""Step lengths, tangents and normals of polylines."""

from __future__ import annotations

import numpy as np


def step_lengths(points: np.ndarray) -> np.ndarray:
    """Compute the distances (K - 1,) between successive points (K, D)."""
    return np.linalg.norm(np.diff(points, axis=0), axis=1)


def unit_tangents(line: np.ndarray) -> np.ndarray:
    """Compute the directions (K, 2) of a line at its points (K, 2)."""
    tangents = np.gradient(line, axis=0)
    lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
    return tangents / np.maximum(lengths, 1e-9)


def turn_left(vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (..., 2) by a right angle, counter-clockwise where y points up."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)
