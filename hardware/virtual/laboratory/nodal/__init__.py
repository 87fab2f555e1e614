"""A laboratory whose string is a rod by absolute nodal coordinates."""

from __future__ import annotations

from stringcast.hardware.virtual.laboratory.hand import Path
from stringcast.hardware.virtual.laboratory.nodal.motion import moved
from stringcast.hardware.virtual.laboratory.rod import Rod
from stringcast.hardware.virtual.laboratory.scene import CHECK, FINE, LIKELY, ROUGH, Moved

LEVELS = {ROUGH: (8, 1e-3), LIKELY: (16, 4e-4), CHECK: (16, 4e-4), FINE: (24, 2.5e-4)}  # elements, step [s]


class Nodal:
    """The laboratory whose rod is made of the elements of `elements` and moves by `dynamics`."""

    likely = 5e-3

    def moved(self, rod: Rod, path: Path, level: int) -> Moved:
        """The rod moved with the elements and steps of a level; see `Laboratory`."""
        return moved(rod, path, *LEVELS[level])
