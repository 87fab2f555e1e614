"""Worlds outside the model: a reference simulator moves the string of the virtual lab.

The lab's own string differs from the model's in its mesh alone. A reference simulator
shares no code with the model, and hides causes that the library does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stringcast.data.schema import DataError
from stringcast.hardware.virtual.bench import Specimen, VirtualBench
from tests.benchmarks.simulators import load_simulator
from tests.benchmarks.simulators.camera_faults import CameraFaults, report_points
from tests.benchmarks.simulators.hand import HandFaults, grasp_path
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import Fidelity, StringMotion, with_settings


@dataclass(frozen=True)
class World:
    """A reference simulator and what it hides.

    Parameters
    ----------
    simulator : its name
    hidden : settings of each hidden cause, such as rod.tip_mass, by name of the cause
    """

    simulator: str
    hidden: Mapping[str, Mapping[str, float]]

    def replace_string(self, bench: VirtualBench) -> ReferenceBench:
        """Put the string of this world onto a bench that has performed a motion."""
        if bench.obstacles.effects:
            raise DataError("", f"simulator {self.simulator} has no obstacles")
        lab = bench.specimen
        specimen = ReferenceSpecimen(
            lab.length, lab.parameters, lab.points, self.hidden
        )
        return ReferenceBench(
            bench.arm,
            bench.camera,
            specimen,
            bench.seed,
            bench.servo,
            performed_motion=bench.performed_motion,
            simulator=self.simulator,
        )


@dataclass(frozen=True)
class ReferenceSpecimen(Specimen):
    """A string whose hidden causes are settings of a reference simulator."""

    def __post_init__(self) -> None:
        """Accept causes that the library does not know."""

    @property
    def settings(self) -> dict[str, float]:
        """Settings of all hidden causes by name."""
        settings: dict[str, float] = {}
        for cause in self.hidden.values():
            settings |= cause
        return settings


@dataclass
class ReferenceBench(VirtualBench):
    """A bench whose string is moved, and seen, by a reference simulator.

    `simulator` is its name. The arm's servo is that of the virtual lab.
    """

    specimen: ReferenceSpecimen
    simulator: str = "nodal"

    @cached_property
    def string_motion(self) -> StringMotion:
        """The string in the performed motion."""
        assert self.performed_motion is not None
        settings = self.specimen.settings
        plain = Rod.from_paper_parameters(
            self.specimen.length, **self.specimen.parameters
        )
        rod = with_settings(plain, "rod", settings)
        faults = with_settings(HandFaults(), "hand", settings)
        path = grasp_path(self.arm, *self.performed_motion, faults)
        return load_simulator(self.simulator).move(rod, path, Fidelity.FINAL)

    def string_at(self, times: np.ndarray) -> np.ndarray:
        """Return the true string at times (F,) [s], (F, n, 2) [m]."""
        arc = self.specimen.string().arc_lengths()
        return self.string_motion.points(times, arc)

    def camera_view(
        self, true: Callable[[np.ndarray], np.ndarray], times: np.ndarray
    ) -> np.ndarray:
        """Return points as reported at the camera's times; see `VirtualBench`."""
        faults = with_settings(CameraFaults(), "camera", self.specimen.settings)
        return report_points(true, times, self.camera, faults)
