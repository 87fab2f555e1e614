"""A cache of simulated points.

A fit often starts where another ended, and many calls compute finite differences at the
same optimum. The key has no noise and no measured points: they do not enter a
simulation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.kept_results import content_digest
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model

MAX_KEPT_NUMBERS = 10_000_000  # 80 MB

Key = tuple[str, tuple[type[Effect], ...], str, bytes]


class KeptPoints:
    """Keep the simulated points of the last candidates of each trial."""

    def __init__(self) -> None:
        self._points: dict[Key, np.ndarray] = {}
        self._numbers = 0

    def find(
        self,
        model: Model,
        trial: PreparedTrial,
        values: np.ndarray,
    ) -> dict[int, np.ndarray]:
        """Look up the points (n, 2) [m] of candidates (C, P), by candidate index."""
        by_candidate = {}
        for candidate, key in enumerate(_keys(model, trial, values)):
            if key in self._points:
                by_candidate[candidate] = self._points[key]
        return by_candidate

    def store(
        self,
        model: Model,
        trial: PreparedTrial,
        values: np.ndarray,
        candidates: Sequence[np.ndarray],
    ) -> None:
        """Keep the points (n, 2) [m] of candidates (C, P)."""
        keys = _keys(model, trial, values)
        for key, points in zip(keys, candidates, strict=True):
            if key not in self._points:
                self._numbers += points.size
                self._points[key] = points
        while self._numbers > MAX_KEPT_NUMBERS:
            oldest = self._points.pop(next(iter(self._points)))
            self._numbers -= oldest.size


def _keys(
    model: Model,
    trial: PreparedTrial,
    values: np.ndarray,
) -> list[Key]:
    # A digest has effects only by name, and a notebook may redefine one
    effects = model.effects
    digest = content_digest(model)
    return [(digest, effects, trial.simulation_digest, row.tobytes()) for row in values]
