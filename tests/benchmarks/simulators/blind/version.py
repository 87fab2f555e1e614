"""Which benches a seed means: names, frozen, so that an effect that is added moves no
bench that was recorded.

What may be hidden stands here by name and in order, not as the library has it. A
version is never changed: the table of recorded benches (tests/benchmarks/diagnosis) and
the text of studies refer to it. What is new goes into a new version, the last of
VERSIONS; see `tests/virtual_lab/test_versions.py`, which says so when an effect is in
none.
"""

from __future__ import annotations

from dataclasses import dataclass

from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import find_effects
from tests.benchmarks.simulators.outside import Outside, causes

NONE, RESOLUTION, PAIR = "none", "resolution", "pair"


@dataclass(frozen=True)
class Version:
    """The causes that a bench may hide. effects: of the library. outside: of
    `tests.benchmarks.simulators.outside`.
    """

    effects: tuple[str, ...]
    outside: tuple[str, ...]

    @property
    def cases(self) -> tuple[str, ...]:
        """One bench after another, so that any run of seeds is balanced."""
        return (*self.effects, RESOLUTION, *self.outside, *(NONE, PAIR) * 8)

    def case(self, seed: int) -> str:
        """An effect, a cause outside the library, or one of NONE, RESOLUTION and PAIR."""
        return self.cases[seed % len(self.cases)]

    def library(self) -> tuple[type[Effect], ...]:
        """The effects, in their order."""
        return find_effects(self.effects)

    def causes(self) -> tuple[type[Outside], ...]:
        """The causes outside the library, in their order."""
        known = {cause.name: cause for cause in causes()}
        return tuple(known[name] for name in self.outside)


SECOND = Version(
    effects=(
        *(
            "anisotropic_drag",
            "arm_lag",
            "backlash",
            "camera_rotation",
            "clock_drift",
            "contact",
            "density_taper",
        ),
        *(
            "grasp_angle",
            "grasp_slip",
            "gravity_direction",
            "maxwell_slip",
            "joint_gain",
            "lens_distortion",
        ),
        *(
            "nonlinear_bending",
            "pixel_scale",
            "rest_curvature",
            "rolling_shutter",
            "time_offset",
            "tip_mass",
            "wind",
        ),
    ),
    outside=(
        *(
            "bumped_camera",
            "dropped_clock",
            "gust",
            "magnet",
            "pulse",
            "soft_spot",
            "sticking_joint",
            "touch",
        ),
        *("vibration", "vortex"),
    ),
)
THIRD = Version(  # what a diagnosis looks for since it is told by evidence alone
    (
        *SECOND.effects,
        "camera_offset",
        "clamp",
        "dahl_friction",
        "grasp_play",
        "standard_linear_solid",
    ),
    SECOND.outside,
)
VERSIONS = {2: SECOND, 3: THIRD}
LATEST = max(VERSIONS)
