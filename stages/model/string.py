"""The string: its mass points and its effects; `stages.model.engine.simulate` moves it.

Parameters are given in the paper's view: per unit mass of one mass point (Table 1), at
`reference_points` mass points. Inside, they are properties of the material (bending
stiffness over mass per length, and so on), so that a value means the same string
whatever the number of points; at `points == reference_points` the two are Eq. 1
exactly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from stringcast.stages.model.effect import StringEffect, is_position_dependent
from stringcast.stages.model.effects.air_drag import AirDrag
from stringcast.stages.model.effects.anisotropic_drag import AnisotropicDrag
from stringcast.stages.model.effects.axial_damper import AxialDamper
from stringcast.stages.model.effects.axial_spring import AxialSpring
from stringcast.stages.model.effects.density_taper import DensityTaper
from stringcast.stages.model.effects.grasp_damper import GraspDamper
from stringcast.stages.model.effects.grasp_spring import GraspSpring
from stringcast.stages.model.effects.gravity import Gravity
from stringcast.stages.model.effects.gravity_direction import GravityDirection
from stringcast.stages.model.effects.hinge_damper import HingeDamper
from stringcast.stages.model.effects.hinge_spring import HingeSpring
from stringcast.stages.model.effects.nonlinear_bending import NonlinearBending
from stringcast.stages.model.effects.rest_curvature import RestCurvature
from stringcast.stages.model.effects.tip_mass import TipMass
from stringcast.stages.model.effects.wind import Wind
from stringcast.stages.model.engine.integrators import Integrator, SemiImplicitEuler
from stringcast.stages.model.engine.law_slots import (
    FREE_LENGTH_ROWS,
    MEMORY_SLOTS,
    Law,
    law_arguments,
    select_arguments,
)
from stringcast.stages.model.parameter import Parameter, Parametrised

# 30 um of 300 mm, far finer than any string converges at; stiffness and steps go with
# its square
MAX_POINTS = 10_000
PAPER_EFFECTS: tuple[type[StringEffect], ...] = (
    Gravity,
    AxialSpring,
    AxialDamper,
    HingeSpring,
    HingeDamper,
    AirDrag,
    GraspSpring,
    GraspDamper,
)
# If any of these is at work the loop holds them all, which takes 1.2 times as long, and
# one loop is compiled (3 s) instead of up to 255. None has a memory; each adds exactly
# nothing where it is absent.
JOINTLY_COMPILED_EFFECTS: tuple[type[StringEffect], ...] = (
    AnisotropicDrag,
    DensityTaper,
    GravityDirection,
    NonlinearBending,
    RestCurvature,
    TipMass,
    Wind,
)


@dataclass(frozen=True)
class String(Parametrised):
    """A chain of mass points hung from the grasp.

    length: rest length [m] from the stated grasp, before or beyond which an effect may
    have it begin. points: n, the first is held by the hand. effects: the forces at
    work. reference_points: the n at which per-mass-point parameters are given.
    tip_cell: mass of the last point, in segments; 1 is Eq. 1 (all points alike), 1/2 is
    second-order accurate in the number of points. grasp_cell: share of a segment's
    bending compliance that lies in the hinge at the grasp; 0 is Eq. 1, 1/2 second-order
    accurate. ranges: parameters whose range or start differ from the effect's own, by
    name. largest_step: step allowed for accuracy [s]; stability may ask for less.
    """

    length: float
    points: int = 10
    effects: tuple[type[StringEffect], ...] = PAPER_EFFECTS
    reference_points: int = 10
    tip_cell: float = 1.0
    grasp_cell: float = 0.0
    ranges: Mapping[str, Parameter] = field(default_factory=dict)
    integrator: Integrator = SemiImplicitEuler()
    largest_step: float = 2.0e-4

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        if self.points < 3:
            raise ValueError(f"string.points is {self.points}; it must be at least 3")
        if self.points > MAX_POINTS:
            raise ValueError(
                f"string.points is {self.points}; it must be {MAX_POINTS} at most"
            )
        unknown = set(self.ranges) - {
            e.qualified_name(p) for e in self.effects for p in e.parameters
        }
        if unknown:
            raise ValueError(
                f"ranges for unknown parameters: {', '.join(sorted(unknown))}"
            )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters of all effects, with qualified names, in the order of
        `values`.
        """
        named = (
            replace(p, name=e.qualified_name(p))
            for e in self.effects
            for p in e.parameters
        )
        return tuple(self.ranges.get(p.name, p) for p in named)

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of what `material` gives: the parameters, what effects derive from
        them, where the string begins.
        """
        derived = (
            f"{e.name}.{d}"
            for e in self.effects
            for d in e.derive_parameters(**{p.name: p.start for p in e.parameters})
        )
        return (
            *self.names,
            *derived,
            *(FREE_LENGTH_ROWS if self._hidden_length_effects else ()),
        )

    def without_absent_effects(self, material: np.ndarray) -> tuple[String, np.ndarray]:
        """The string without effects that are absent in every candidate, whose laws add
        nothing, and its material.

        For what is found before the first step, whose price goes with the number of
        laws. material: (C, rows). Forces that depend on place stay: the rest position
        is sought in another way where there is one.
        """
        acts = np.any(material[:, : len(self.names)] != self._absent_material, axis=0)
        return self.with_only_effects(
            tuple(
                e
                for e, places in self._removable_effects.items()
                if not places or acts[places].any()
            ),
            material,
        )

    def with_only_effects(
        self, effects: tuple[type[StringEffect], ...], material: np.ndarray
    ) -> tuple[String, np.ndarray]:
        """The string with some of its effects, and its material. material: (C, rows)."""
        if effects not in self._restricted_strings:
            names = {e.qualified_name(p) for e in effects for p in e.parameters}
            string = replace(
                self,
                effects=effects,
                ranges={n: p for n, p in self.ranges.items() if n in names},
            )
            self._restricted_strings[effects] = (
                string,
                np.array([self.row_names.index(row) for row in string.row_names]),
            )
        string, places = self._restricted_strings[effects]
        return string, material[:, places]

    def with_compiled_effects(self, material: np.ndarray) -> tuple[String, np.ndarray]:
        """The string with what is compiled together, and its material: the rest of that
        is absent. The paper's forces alone stay alone. material: (C, rows).
        """
        if not self._jointly_compiled:
            return self, material
        string, places, absent = self._compiled_string
        filled = np.repeat(absent[None], len(material), axis=0)
        filled[:, places] = material
        return string, filled

    @cached_property
    def _jointly_compiled(self) -> tuple[type[StringEffect], ...]:
        """What goes into a loop with these effects."""
        return (
            JOINTLY_COMPILED_EFFECTS if set(PAPER_EFFECTS) < set(self.effects) else ()
        )

    @cached_property
    def _compiled_string(self) -> tuple[String, list[int], np.ndarray]:
        """The string with that, the places of this one's rows among its own, and a row
        of it in which all is absent.
        """
        string = replace(
            self,
            effects=(
                *(e for e in self.effects if e not in self._jointly_compiled),
                *self._jointly_compiled,
            ),
        )
        start = np.array([p.start for e in string.effects for p in e.parameters])
        return (
            string,
            [string.row_names.index(row) for row in self.row_names],
            string.material(start),
        )

    @cached_property
    def _absent_material(self) -> np.ndarray:
        """(P,) material at which each effect is absent."""
        own = np.array([p.start for e in self.effects for p in e.parameters])
        return self.material(own)[: len(own)]

    @cached_property
    def _removable_effects(self) -> dict[type[StringEffect], list[int]]:
        """Places of the parameters of effects that add nothing where they are absent;
        none for all others.
        """
        stay = {
            e for e in self.effects if e in PAPER_EFFECTS or is_position_dependent(e)
        }
        return {
            e: []
            if e in stay
            else [self.names.index(e.qualified_name(p)) for p in e.parameters]
            for e in self.effects
        }

    @cached_property
    def _restricted_strings(
        self,
    ) -> dict[tuple[type[StringEffect], ...], tuple[String, np.ndarray]]:
        """Strings with fewer effects, and the places of their rows."""
        return {}

    @property
    def segment_length(self) -> float:
        """Rest length of a segment [m]."""
        return self.length / (self.points - 1)

    def arc_lengths(self) -> np.ndarray:
        """(n,) arc length of each mass point from the grasp [m]."""
        return np.arange(self.points) * self.segment_length

    def segment_middles(self) -> np.ndarray:
        """(n - 1,) arc length of each segment's middle from the grasp [m]."""
        return self.arc_lengths()[1:] - self.segment_length / 2

    def free_length_ratio(self, material: np.ndarray) -> np.ndarray:
        """Length of the free string over that stated, (...). material: (..., P)."""
        total = np.ones(material.shape[:-1])
        for effect in self._hidden_length_effects:
            law = effect.laws()["hidden_length"]
            total = (
                total
                + law(**select_arguments(law, self.effect_parameters(effect, material)))
                / self.length
            )
        return total

    @cached_property
    def _hidden_length_effects(self) -> tuple[type[StringEffect], ...]:
        """Effects by which the free string begins elsewhere than stated."""
        return tuple(e for e in self.effects if "hidden_length" in e.laws())

    def free_segment_lengths(self, material: np.ndarray) -> np.ndarray:
        """Rest length of a segment as it really is, (...) [m]. material: (..., P)."""
        return self.segment_length * self.free_length_ratio(material)

    def free_arc_lengths(self, material: np.ndarray) -> np.ndarray:
        """Arc length of each mass point from where the free string begins, (C, n) [m].
        material: (C, P).
        """
        return self.arc_lengths() * self.free_length_ratio(material)[:, None]

    def start_values(self) -> np.ndarray:
        """(P,) start values of the parameters."""
        return np.array([p.start for p in self.parameters])

    def material(self, values: np.ndarray) -> np.ndarray:
        """Material properties from per-mass-point values, and what effects derive.
        (..., P) to (..., rows).
        """
        reference = self.length / (self.reference_points - 1)
        material = values * reference ** np.array(
            [p.length_power for p in self.parameters], dtype=float
        )
        names = (
            "grasp_stiffness",
            "grasp_damping",
            "bending_stiffness",
            "bending_damping",
        )
        if self.grasp_cell and set(names) <= set(self.names):
            # The hinge at the grasp, softened by the bending of its share of the first
            # segment. Of its angle the string's share is that of the compliances, and
            # so it is of its rate: that is how springs in series divide it, as long as
            # dampers beside them are slow. Moments follow by virtual work.
            places = [self.names.index(name) for name in names]
            stiffness, damping, own_stiffness, own_damping = (
                material[..., place] for place in places
            )
            cell = self.grasp_cell * self.free_segment_lengths(material)
            share = stiffness / (stiffness + own_stiffness / cell)
            softened = (
                share * own_stiffness / cell,
                (1 - share) ** 2 * damping + share**2 * own_damping / cell,
            )
            material[..., places[0]], material[..., places[1]] = softened
        columns = [
            column
            for e in self.effects
            for column in e.derive_parameters(
                **self.effect_parameters(e, material)
            ).values()
        ]
        if self._hidden_length_effects:
            columns += [
                self.free_length_ratio(material),
                1 / self.free_segment_lengths(material),
            ]
        return np.concatenate(
            [material, *(column[..., None] for column in columns)], axis=-1
        )

    def effect_parameters(
        self, effect: type[StringEffect], material: np.ndarray
    ) -> dict[str, np.ndarray]:
        """An effect's own parameters, (...) each, by name. material: (..., P)."""
        places = {
            p.name: self.names.index(effect.qualified_name(p))
            for p in effect.parameters
        }
        return {name: material[..., place] for name, place in places.items()}

    def uses_argument(self, slots: Sequence[str], names: Sequence[str]) -> bool:
        """Whether a law in one of these slots takes an argument of one of these names."""
        return any(
            {*names} & {*taken}
            for slot in slots
            for _, taken, _ in self._laws.get(slot, ())
        )

    def law_values(
        self, slot: str, material: np.ndarray, given: Mapping[str, np.ndarray]
    ) -> Iterator[Any]:
        """The contribution of each law in a slot. material: (C, rows). given: the
        slot's arguments by name, (1 or C, M) each.
        """
        for law in self._laws.get(slot, ()):
            yield _evaluate_law(law, material, given)

    def memory_count(self, slot: str) -> int:
        """The number of effects with memory whose moment belongs to a slot: `moment` or
        `grasp_moment`.
        """
        return len(self._laws.get(MEMORY_SLOTS[slot][0], ()))

    def updated_memory(
        self,
        slot: str,
        material: np.ndarray,
        change: np.ndarray,
        before: Sequence[np.ndarray] | None = None,
        lapse: float = np.inf,
    ) -> list[np.ndarray]:
        """The state of each effect with a memory after a change of curvature, or of the
        grasp's angle, (1 or C, M) each [1/m] or [rad].

        slot: that of the moment. material: (C, rows). change: (1 or C, M), in a time
        `lapse` [s]. before: the states before it, (1 or C, M) each; if not given, zero:
        with the lapse as it is, it was bent slowly from straight.
        """
        laws = self._laws.get(MEMORY_SLOTS[slot][0], [])
        known = {"change": change, "dt": np.full((1, 1), lapse)}
        start = [np.zeros((1, 1))] * len(laws) if before is None else before
        return [
            _evaluate_law(law, material, {**known, "held": held})
            for law, held in zip(laws, start, strict=True)
        ]

    def memory_moments(
        self, slot: str, material: np.ndarray, held: Sequence[np.ndarray]
    ) -> Iterator[Any]:
        """The moment of what is held, for each effect with a memory. held: in the order
        of `self.held`.
        """
        for law, state in zip(
            self._laws.get(MEMORY_SLOTS[slot][1], ()), held, strict=True
        ):
            yield _evaluate_law(law, material, {"held": state})

    @cached_property
    def _laws(self) -> dict[str, list[BoundLaw]]:
        """The laws in each slot."""
        found: dict[str, list[BoundLaw]] = {}
        for effect in self.effects:
            for slot, law in effect.laws().items():
                names = law_arguments(law)
                # an effect's own parameter before another's of the same name
                rows = {
                    n: [q for q in (f"{effect.name}.{n}", n) if q in self.row_names]
                    for n in names
                }
                places = {
                    name: self.row_names.index(own[0])
                    for name, own in rows.items()
                    if own
                }
                found.setdefault(slot, []).append((law, names, places))
        return found

    def point_masses(self, material: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Masses of the points over nominal mass per length [m], and the length each
        stands for [m].

        material: (C, P). Returns (C, n) each.
        """
        longer = self.free_length_ratio(material)[:, None]
        cells = np.repeat(self.segment_length * longer, self.points, axis=1)
        cells[:, -1] *= self.tip_cell
        if not {"tip_length", "density", "tip_mass"} & self._laws.keys():
            return cells.copy(), cells
        density = np.ones((len(material), self.points))
        tip = np.zeros((len(material), 1))
        given = {"s": self.free_arc_lengths(material), "length": self.length * longer}
        for longer in self.law_values("tip_length", material, given):
            cells[:, -1:] += longer
        for denser in self.law_values("density", material, given):
            density = density + denser
        for heavier in self.law_values("tip_mass", material, given):
            tip = tip + heavier
        masses = density * cells
        masses[:, -1:] += tip
        return masses, cells


# A law, the names of what it takes, and the rows of `material` where those of them that
# are parameters are.
BoundLaw = tuple[Law, tuple[str, ...], dict[str, int]]


def _evaluate_law(
    bound: BoundLaw, material: np.ndarray, given: Mapping[str, np.ndarray]
) -> Any:
    """A law's value for all candidates. material: (C, rows). given: the slot's
    arguments, (1 or C, M) each.
    """
    law, names, places = bound
    parameters = {name: material[:, place, None] for name, place in places.items()}
    return law(**{name: given[name] for name in names if name in given}, **parameters)
