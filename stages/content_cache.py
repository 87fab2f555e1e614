"""Results of the last calls, by the content of what decides them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from stringcast.stages.kept_results import content_digest

ResultT = TypeVar("ResultT")


class ContentCache(Generic[ResultT]):
    """Keep the results of the last calls.

    Parameters
    ----------
    size
        Number of results that are kept.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._results: dict[str, ResultT] = {}

    def find_or_make(
        self, parts: Sequence[np.ndarray], make: Callable[[], ResultT]
    ) -> ResultT:
        """Return the result that belongs to these arrays, made if it is not kept."""
        key = content_digest(parts)
        result = self._results.pop(key) if key in self._results else make()
        self._results[key] = result  # the last one is the newest
        while len(self._results) > self.size:
            del self._results[next(iter(self._results))]
        return result
