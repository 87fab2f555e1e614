"""The nodal rod as a reference simulator."""

from __future__ import annotations

from tests.benchmarks.simulators.causes import LIBRARY_CAUSES, OUTSIDE_CAUSES
from tests.benchmarks.simulators.hand import GraspPath
from tests.benchmarks.simulators.nodal.motion import NodalMotion, simulate_rod
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import Fidelity, Simulator

# Elements and largest step [s].
MESHES = {
    Fidelity.SEARCH: (8, 1e-3),
    Fidelity.SCREENING: (16, 4e-4),
    Fidelity.CHECK: (16, 4e-4),
    Fidelity.FINAL: (24, 2.5e-4),
}


class Nodal(Simulator):
    """The simulator whose rod is made of cubic elements."""

    screening_tolerance = 5e-3
    causes = (*LIBRARY_CAUSES, *OUTSIDE_CAUSES)

    def move(self, rod: Rod, path: GraspPath, fidelity: Fidelity) -> NodalMotion:
        """Simulate the rod; see `Simulator.move`."""
        return simulate_rod(rod, path, *MESHES[fidelity])
