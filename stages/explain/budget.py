"""The processor time of a search for causes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from stringcast.stages.common import Progress


@dataclass
class Budget:
    """Processor time that may be used.

    Parameters
    ----------
    seconds : processor time [s]
    progress : called with the used share
    longest_fit : longest time of a fit so far [s]
    longest_screening : longest time of a screening of all effects so far [s]
    """

    seconds: float
    progress: Progress
    longest_fit: float = 0.0
    longest_screening: float = 0.0

    def __post_init__(self) -> None:
        """Start the clock."""
        self.began = time.process_time()

    def is_used_up(self, fits: float = 1.0, screenings: float = 0.0) -> bool:
        """Return whether too little time is left for fits and screenings."""
        used = time.process_time() - self.began
        self.progress(min(used / max(self.seconds, 1e-9), 1.0))
        needed = fits * self.longest_fit + screenings * self.longest_screening
        return used + needed > self.seconds

    @contextmanager
    def measure_fit(self) -> Iterator[None]:
        """Measure the time of a fit."""
        began = time.process_time()
        yield
        self.longest_fit = max(self.longest_fit, time.process_time() - began)

    @contextmanager
    def measure_screening(self) -> Iterator[None]:
        """Measure the time of a screening."""
        began = time.process_time()
        yield
        taken = time.process_time() - began
        self.longest_screening = max(self.longest_screening, taken)
