"""A laboratory whose string is a rod by absolute nodal coordinates."""

from __future__ import annotations

from tests.benchmarks.simulators.laboratory.hand import Path
from tests.benchmarks.simulators.laboratory.nodal.motion import moved
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.scene import (
    CHECK,
    FINE,
    LIKELY,
    ROUGH,
    Moved,
)

# elements, step [s]
LEVELS = {ROUGH: (8, 1e-3), LIKELY: (16, 4e-4), CHECK: (16, 4e-4), FINE: (24, 2.5e-4)}


class Nodal:
    """The laboratory whose rod is made of the elements of `elements` and moves by
    `dynamics`.
    """

    likely = 5e-3

    def moved(self, rod: Rod, path: Path, level: int) -> Moved:
        """The rod moved with the elements and steps of a level; see `Laboratory`."""
        return moved(rod, path, *LEVELS[level])
