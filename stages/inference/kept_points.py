"""Simulated points of the last candidates, by all that decides them.

A fit ends where the next one begins, and many calls difference a model about the same
optimum. Other noise or other measured points change nothing of what is simulated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.kept_results import content_digest
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model

MAX_KEPT_NUMBERS = 10_000_000  # 80 MB

PointsByTrial = Sequence[np.ndarray]
Key = tuple[str, tuple[type[Effect], ...], tuple[str, ...], bytes]


class KeptPoints:
    """Keep the simulated points of the last candidates in each trial."""

    def __init__(self) -> None:
        self._points: dict[Key, PointsByTrial] = {}
        self._numbers = 0

    def find(
        self,
        model: Model,
        trials: Sequence[PreparedTrial],
        values: np.ndarray,
    ) -> list[PointsByTrial | None]:
        """Look up the points (n, 2) [m] in each trial of candidates (C, P)."""
        return [self._points.get(key) for key in _keys(model, trials, values)]

    def store(
        self,
        model: Model,
        trials: Sequence[PreparedTrial],
        values: np.ndarray,
        candidates: Sequence[PointsByTrial],
    ) -> None:
        """Keep the points (n, 2) [m] in each trial of candidates (C, P)."""
        keys = _keys(model, trials, values)
        for key, points in zip(keys, candidates, strict=True):
            if key not in self._points:
                self._numbers += sum(each.size for each in points)
                self._points[key] = points
        while self._numbers > MAX_KEPT_NUMBERS:
            oldest = self._points.pop(next(iter(self._points)))
            self._numbers -= sum(each.size for each in oldest)


def _keys(
    model: Model,
    trials: Sequence[PreparedTrial],
    values: np.ndarray,
) -> list[Key]:
    # A digest knows effects by name, and a notebook may define one again
    effects = model.effects
    digest = content_digest(model)
    by_trial = tuple(trial.simulation_digest for trial in trials)
    return [(digest, effects, by_trial, row.tobytes()) for row in values]
