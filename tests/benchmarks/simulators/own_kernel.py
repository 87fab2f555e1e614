"""The library's own kernel as a reference simulator, on a far finer mesh.

It hides any effect of the library that a diagnosis looks for, by sampling the ranges of
its parameters: an effect that is added is hidden without any change here. Causes
outside the library are those of `causes.py`; where they act on the string, their laws
are in `own_kernel_effects.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stringcast.stages.model.effect import Effect, StringEffect
from stringcast.stages.model.effects.equal_points import EqualPoints
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import (
    HandMotion,
    resample_hand_motion,
    resample_joint_motion,
)
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.benchmarks.simulators.camera_faults import CameraFaults
from tests.benchmarks.simulators.causes import (
    OUTSIDE_ARM_AND_CAMERA_CAUSES,
    OUTSIDE_STRING_CAUSES,
    Cause,
    DrawEnds,
    Ends,
    PlainTrials,
    plane_positions,
)
from tests.benchmarks.simulators.hand import GraspPath
from tests.benchmarks.simulators.motions import Cast
from tests.benchmarks.simulators.own_kernel_effects import OUTSIDE_EFFECTS
from tests.benchmarks.simulators.rod import BASE_FIELDS, Rod
from tests.benchmarks.simulators.scene import (
    Fidelity,
    Scene,
    Settings,
    Simulator,
    with_settings,
)

# Mass points and largest step [s]. With 160 points a tip that cracks is a quarter of
# the noise off, with 40 points four times the noise.
MESHES = {
    Fidelity.SEARCH: (21, 5e-4),
    Fidelity.SCREENING: (29, 5e-4),
    Fidelity.CHECK: (113, 1.4e-4),
    Fidelity.FINAL: (160, 1e-4),
}
HAND_TICK_S = 0.001
# prefixes of settings that belong to no effect
RECORD_PREFIXES = ("rod.", "hand.", "camera.")


@dataclass(frozen=True)
class KernelMotion:
    """A string of mass points in a moving hand; see `StringMotion`."""

    string: String
    hand: HandMotion
    values: np.ndarray

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Return positions (F, S, 2) [m] at times (F,) [s] and arc lengths (S,) [m]."""
        points = simulate(self.string, self.hand, self.values, times).points[0]
        return interpolate_along_string(points, arc / self.string.length)


class OwnKernel(Simulator):
    """The library's own kernel."""

    screening_tolerance = 3.5e-3

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """The effects of the library, and causes outside it that have a law."""
        of_library = [library_cause(effect) for effect in hideable_effects()]
        names = [effect.name for effect in OUTSIDE_EFFECTS]
        on_string = [c for c in OUTSIDE_STRING_CAUSES if c.name in names]
        return (*of_library, *on_string, *OUTSIDE_ARM_AND_CAMERA_CAUSES)

    @property
    def outside_causes_of_mixtures(self) -> tuple[Cause, ...]:
        """Those that are effects, as the causes of the library are here."""
        names = [effect.name for effect in OUTSIDE_EFFECTS]
        return tuple(cause for cause in self.causes if cause.name in names)

    def move(self, rod: Rod, path: GraspPath, fidelity: Fidelity) -> KernelMotion:
        """Simulate a rod with causes outside the library; see `Simulator.move`."""
        plain = Rod(*rod[: 1 + len(BASE_FIELDS)])
        string = make_string(rod.length, fidelity, with_all_effects=rod != plain)
        settings = rod.paper_parameters() | outside_settings(rod)
        t = np.arange(path.start, path.end, HAND_TICK_S)
        hand = resample_hand_motion(t, path.pose(t), HAND_TICK_S)
        return KernelMotion(string, hand, string.values(settings)[None])

    def observe(
        self, scene: Scene, cast: Cast, settings: Settings, fidelity: Fidelity
    ) -> np.ndarray:
        """Simulate effects of the library, or other causes; see `Simulator.observe`.

        Beside effects of the library act causes on the string outside it, and errors
        of clock and arc lengths.
        """
        of_effects = {}
        for name, value in settings.items():
            if not name.startswith(RECORD_PREFIXES):
                of_effects[name] = value
        if not of_effects:
            return super().observe(scene, cast, settings, fidelity)
        active = {name.partition(".")[0] for name in of_effects}
        effects = [effect for effect in hideable_effects() if effect.name in active]
        others = [effect for effect in effects if not issubclass(effect, StringEffect)]
        rod = with_settings(scene.rod, "rod", settings)
        faults = with_settings(CameraFaults(), "camera", settings)
        acts_on_string = len(others) < len(effects) or rod != scene.rod
        string = make_string(rod.length, fidelity, acts_on_string)
        model = Model(string, scene.arm, scene.camera).with_effects(*others)
        all_settings = rod.paper_parameters() | of_effects
        if acts_on_string:
            all_settings |= outside_settings(rod)
        values = model.values(all_settings)[None]
        motion = resample_joint_motion(cast.fine, cast.angles, HAND_TICK_S)
        times = cast.frames + faults.offset
        points = model.simulate_observation(motion, values, times).points[0]
        arc = scene.s * (1 + faults.length_error)
        return interpolate_along_string(points, arc / rod.length)


def outside_settings(rod: Rod) -> dict[str, float]:
    """Return the parameters of effects outside the library, by qualified name."""
    settings = {}
    for effect in OUTSIDE_EFFECTS:
        for parameter in effect.parameters:
            name = effect.qualified_name(parameter)
            settings[name] = getattr(rod, parameter.name)
    return settings


def make_string(length: float, fidelity: Fidelity, with_all_effects: bool) -> String:
    """Return a string of second order in its mesh.

    `with_all_effects` adds every effect on the string that may be hidden, so that one
    compiled loop serves them all.
    """
    effects = PAPER_EFFECTS
    if with_all_effects:
        of_library = [e for e in hideable_effects() if issubclass(e, StringEffect)]
        effects = (*PAPER_EFFECTS, *of_library, *OUTSIDE_EFFECTS)
    points, largest_step = MESHES[fidelity]
    return String(
        length,
        points,
        effects,
        tip_cell=0.5,
        grasp_cell=0.5,
        integrator=ImplicitLeapfrog(),
        largest_step=largest_step,
    )


def hideable_effects() -> list[type[Effect]]:
    """Return the effects of the library that a diagnosis looks for, but for two kinds.

    Changes of the mesh are no cause here, nor is what stands for a coarse mesh.
    """
    effects = []
    for effect in effects_by_name().values():
        is_base = (
            effect in PAPER_EFFECTS
            or bool(effect.exclusion_reason)
            or effect is EqualPoints
        )
        if effect.parameters and not is_base:
            effects.append(effect)
    return effects


def library_cause(effect: type[Effect]) -> Cause:
    """Return an effect of the library as a cause."""
    draw_ends = _draw_contact if effect.name == "contact" else sample_ranges(effect)
    return Cause(
        effect.name,
        draw_ends,
        parameters=dict,
        directions=len(effect.parameters),
    )


def sample_ranges(effect: type[Effect]) -> DrawEnds:
    """Let an effect grow to values that are drawn from its ranges.

    Parameters that start at zero grow from there; others stay as they are drawn. If one
    alone grows, it grows to an end of its range.
    """
    growing = [p for p in effect.parameters if p.start == 0.0]

    def draw(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
        absent: dict[str, float] = {}
        full: dict[str, float] = {}
        for parameter in effect.parameters:
            name = effect.qualified_name(parameter)
            full[name] = float(parameter.value(np.asarray(rng.uniform())))
            absent[name] = full[name]
            if parameter in growing:
                absent[name] = 0.0
                ends = [end for end in (parameter.low, parameter.high) if end != 0.0]
                if len(growing) == 1:
                    full[name] = float(rng.choice(ends))
        return absent, full

    return draw


def _draw_contact(
    rng: np.random.Generator, trials: PlainTrials, trial: int
) -> Ends | None:
    """Let a plane come closer from where the string just touches it.

    A plane anywhere in the ranges would seldom touch the string, and its stiffness
    would have to grow instead.
    """
    positions = plane_positions(rng, trials)
    if positions is None:
        return None
    tilt, touched, highest = positions
    same = {
        "contact.tilt": tilt,
        "contact.stiffness": float(np.exp(rng.uniform(*np.log([1e4, 4e6])))),
        "contact.friction": float(rng.uniform(0, 0.5)),
        "contact.loss": float(rng.uniform(0, 0.4)),
    }
    return {"contact.height": touched, **same}, {"contact.height": highest, **same}


def interpolate_along_string(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return points (F, S, 2) at places (S,) in [0, 1] along mass points (F, n, 2)."""
    segments = points.shape[1] - 1
    position = np.clip(place * segments, 0, segments - 1e-9)
    before = position.astype(int)
    share = (position % 1)[:, None]
    return points[:, before] * (1 - share) + points[:, before + 1] * share
