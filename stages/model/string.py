"""The string: its mass points and effects. `engine.simulate` moves it.

Parameters are given as in the paper: per unit mass of one mass point (Table 1), for
`reference_points` mass points. They are converted to properties of the material, such
as bending stiffness over mass per length. So a value means the same string at any
number of points. At `points == reference_points` the model is Eq. 1 exactly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from stringcast.stages.model.effect import StringEffect, is_position_dependent
from stringcast.stages.model.effects.air_drag import AirDrag
from stringcast.stages.model.effects.anisotropic_drag import AnisotropicDrag
from stringcast.stages.model.effects.axial_damper import AxialDamper
from stringcast.stages.model.effects.axial_spring import AxialSpring
from stringcast.stages.model.effects.clamp import Clamp
from stringcast.stages.model.effects.contact import Contact
from stringcast.stages.model.effects.dahl_friction import DahlFriction
from stringcast.stages.model.effects.density_taper import DensityTaper
from stringcast.stages.model.effects.equal_points import EqualPoints
from stringcast.stages.model.effects.grasp_damper import GraspDamper
from stringcast.stages.model.effects.grasp_play import GraspPlay
from stringcast.stages.model.effects.grasp_spring import GraspSpring
from stringcast.stages.model.effects.gravity import Gravity
from stringcast.stages.model.effects.gravity_direction import GravityDirection
from stringcast.stages.model.effects.hinge_damper import HingeDamper
from stringcast.stages.model.effects.hinge_spring import HingeSpring
from stringcast.stages.model.effects.maxwell_slip import MaxwellSlip
from stringcast.stages.model.effects.nonlinear_bending import NonlinearBending
from stringcast.stages.model.effects.rest_curvature import RestCurvature
from stringcast.stages.model.effects.standard_linear_solid import StandardLinearSolid
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
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.parametrised import Parametrised

# Segments of 30 um for 300 mm, far finer than convergence needs. Stiffness and the
# number of steps grow with its square.
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
# If any of these is active, the loop contains them all. It takes 1.2 times as long, but
# only one loop is compiled (4 s) instead of up to 511. None has memory. An absent one
# adds exactly zero.
JOINTLY_COMPILED_EFFECTS: tuple[type[StringEffect], ...] = (
    AnisotropicDrag,
    Clamp,
    DensityTaper,
    EqualPoints,
    GravityDirection,
    NonlinearBending,
    RestCurvature,
    TipMass,
    Wind,
)
# If any of these is active, one loop contains all of them and those above. It takes 1.1
# times as long as with one of them.
COSTLY_EFFECTS: tuple[type[StringEffect], ...] = (
    Contact,
    DahlFriction,
    GraspPlay,
    MaxwellSlip,
    StandardLinearSolid,
)
GRASP_AND_BENDING = (
    "grasp_stiffness",
    "grasp_damping",
    "bending_stiffness",
    "bending_damping",
)

Effects = tuple[type[StringEffect], ...]
# A law, the names of its arguments, and the rows of its parameters in `material`.
BoundLaw = tuple[Law, tuple[str, ...], dict[str, int]]


@dataclass(frozen=True)
class String(Parametrised):
    """A chain of mass points that hangs from the grasp.

    Parameters
    ----------
    length : float
        Rest length from the stated grasp [m]. An effect may move the beginning.
    points : int
        Number of mass points n. The hand holds the first.
    effects : tuple of StringEffect classes
        The active forces.
    reference_points : int
        The n at which per-mass-point parameters are given.
    tip_cell : float
        Mass of the last point, in segments. 1 is Eq. 1 (all points alike), 1/2 is
        second-order accurate in the number of points.
    grasp_cell : float
        Share of a segment's bending compliance that lies in the hinge at the grasp. 0
        is Eq. 1, 1/2 second-order accurate.
    ranges : mapping of str to Parameter
        Parameters whose range or start differ from the effect's own, by name.
    integrator : Integrator
        The time step.
    largest_step : float
        Largest step for accuracy [s]. Stability may need a smaller one.

    Raises
    ------
    ValueError
        If there are too few or too many points, or ranges of unknown parameters.
    """

    length: Annotated[float, Field(gt=0, le=100.0)]
    points: int = 10
    effects: Effects = PAPER_EFFECTS
    reference_points: int = 10
    tip_cell: float = 1.0
    grasp_cell: float = 0.0
    ranges: Mapping[str, Parameter] = field(default_factory=dict)
    integrator: Integrator = SemiImplicitEuler()
    largest_step: Annotated[float, Field(ge=1e-6, le=0.1)] = 2.0e-4

    def __post_init__(self) -> None:
        """Refuse meshes that cannot be simulated."""
        if self.points < 3:
            raise ValueError(f"string.points is {self.points}; it must be at least 3")
        if self.points > MAX_POINTS:
            raise ValueError(
                f"string.points is {self.points}; it must be {MAX_POINTS} at most"
            )
        unknown = set(self.ranges) - _parameter_names(self.effects)
        if unknown:
            names = ", ".join(sorted(unknown))
            raise ValueError(f"ranges for unknown parameters: {names}")

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of all effects, with qualified names, in the order of `values`."""
        parameters = []
        for effect in self.effects:
            for parameter in effect.qualified_parameters():
                parameters.append(self.ranges.get(parameter.name, parameter))
        return tuple(parameters)

    # --- material: parameters of the laws -----------------------------------

    @cached_property
    def row_names(self) -> tuple[str, ...]:
        """Names of the rows of `material`.

        They are the parameters, quantities that effects derive from them and, if an
        effect may move the beginning of the free string, its length.
        """
        names = list(self.names)
        for effect in self.effects:
            start = {p.name: p.start for p in effect.parameters}
            derived = effect.derive_parameters(**start)
            names += [f"{effect.name}.{name}" for name in derived]
        if self._hidden_length_effects:
            names += FREE_LENGTH_ROWS
        return tuple(names)

    def start_values(self) -> np.ndarray:
        """Return the start values of the parameters, (P,)."""
        return np.array([p.start for p in self.parameters])

    def material(self, values: np.ndarray) -> np.ndarray:
        """Turn per-mass-point values into material properties.

        Parameters
        ----------
        values : ndarray of shape (..., P)
            In the order of `parameters`.

        Returns
        -------
        ndarray of shape (..., rows)
            In the order of `row_names`.
        """
        reference = self.length / (self.reference_points - 1)
        powers = np.array([p.length_power for p in self.parameters], dtype=float)
        material = values * reference**powers
        if self.grasp_cell and set(GRASP_AND_BENDING) <= set(self.names):
            self._soften_grasp(material)
        columns: list[np.ndarray] = []
        for effect in self.effects:
            effect_values = self.values_of(effect, material)
            columns += effect.derive_parameters(**effect_values).values()
        if self._hidden_length_effects:
            per_segment = 1 / self.free_segment_lengths(material)
            columns += [self.free_length_ratio(material), per_segment]
        return np.concatenate([material, *(c[..., None] for c in columns)], axis=-1)

    def _soften_grasp(self, material: np.ndarray) -> None:
        """Soften the hinge at the grasp, in place, by its share of the first segment.

        The clamp and the string's share of the segment are springs in series. They
        share the hinge's angle and its rate in proportion to their compliances, if the
        dampers in parallel are slow. Moments follow from virtual work.
        """
        places = [self.names.index(name) for name in GRASP_AND_BENDING]
        stiffness, damping, bending_stiffness, bending_damping = (
            material[..., place] for place in places
        )
        cell = self.grasp_cell * self.free_segment_lengths(material)
        string_share = stiffness / (stiffness + bending_stiffness / cell)
        clamp_damping = (1 - string_share) ** 2 * damping
        string_damping = string_share**2 * bending_damping / cell
        softened_stiffness = string_share * bending_stiffness / cell
        material[..., places[0]] = softened_stiffness
        material[..., places[1]] = clamp_damping + string_damping

    # --- the same string with fewer or more effects -------------------------

    def without_absent_effects(self, material: np.ndarray) -> tuple[String, np.ndarray]:
        """Remove effects that are absent in all candidates; return string and material.

        Statics and step sizes take time in proportion to the number of laws. Forces
        that depend on place stay, because the method of statics depends on them.

        material: (C, rows).
        """
        parameters = material[:, : len(self.names)]
        is_present = np.any(parameters != self._absent_parameters, axis=0)
        kept = []
        for effect in self.effects:
            columns = self._removable_effects.get(effect)
            if columns is None or is_present[columns].any():
                kept.append(effect)
        return self.with_only_effects(tuple(kept), material)

    def with_only_effects(
        self, effects: Effects, material: np.ndarray
    ) -> tuple[String, np.ndarray]:
        """Keep only some effects; return string and material (C, rows)."""
        if effects not in self._restricted_strings:
            names = _parameter_names(effects)
            ranges = {n: p for n, p in self.ranges.items() if n in names}
            string = replace(self, effects=effects, ranges=ranges)
            columns = [self.row_names.index(row) for row in string.row_names]
            self._restricted_strings[effects] = string, columns
        string, columns = self._restricted_strings[effects]
        return string, material[:, columns]

    def with_compiled_effects(self, material: np.ndarray) -> tuple[String, np.ndarray]:
        """Add all jointly compiled effects, with values at which they are absent.

        Returns string and material. A string with the paper's forces only is not
        changed.

        material: (C, rows).
        """
        if not set(PAPER_EFFECTS) < set(self.effects):
            return self, material
        string, absent_material, columns = self._compiled_string
        compiled_material = np.tile(absent_material, (len(material), 1))
        compiled_material[:, columns] = material
        return string, compiled_material

    @cached_property
    def _compiled_string(self) -> tuple[String, np.ndarray, list[int]]:
        """String with all jointly compiled effects, its material and columns.

        The material (rows,) has all effects absent; the columns are those of this
        string's own material in it.
        """
        joint = (*PAPER_EFFECTS, *JOINTLY_COMPILED_EFFECTS)
        if set(COSTLY_EFFECTS) & set(self.effects):
            joint = (*joint, *COSTLY_EFFECTS)
        others = [effect for effect in self.effects if effect not in joint]
        string = replace(self, effects=(*joint, *others))
        columns = [string.row_names.index(row) for row in self.row_names]
        return string, string.material(_absent_values(string.effects)), columns

    @cached_property
    def _absent_parameters(self) -> np.ndarray:
        """Parameters in `material` at which each effect is absent, (P,)."""
        return self.material(_absent_values(self.effects))[: len(self.names)]

    @cached_property
    def _removable_effects(self) -> dict[type[StringEffect], list[int]]:
        """Effects that may be removed, and the columns of their parameters."""
        removable = {}
        for effect in self.effects:
            names = [p.name for p in effect.qualified_parameters()]
            is_kept = effect in PAPER_EFFECTS or is_position_dependent(effect)
            if names and not is_kept:
                removable[effect] = [self.names.index(name) for name in names]
        return removable

    @cached_property
    def _restricted_strings(self) -> dict[Effects, tuple[String, list[int]]]:
        """Cache of `with_only_effects`: strings, and columns of material."""
        return {}

    # --- geometry -----------------------------------------------------------

    @property
    def segment_length(self) -> float:
        """Rest length of a segment [m]."""
        return self.length / (self.points - 1)

    def arc_lengths(self) -> np.ndarray:
        """Return the arc length of each mass point from the grasp, (n,) [m]."""
        return np.arange(self.points) * self.segment_length

    def segment_middles(self) -> np.ndarray:
        """Return the arc lengths of the segments' middles, (n - 1,) [m]."""
        return self.arc_lengths()[1:] - self.segment_length / 2

    def free_length_ratio(self, material: np.ndarray) -> np.ndarray:
        """Return the length of the free string over the stated length, (...).

        material: (..., P).
        """
        ratio = np.ones(material.shape[:-1])
        for effect in self._hidden_length_effects:
            law = effect.laws()["hidden_length"]
            effect_values = self.values_of(effect, material)
            ratio = ratio + law(**select_arguments(law, effect_values)) / self.length
        return ratio

    @cached_property
    def _hidden_length_effects(self) -> Effects:
        """Effects that move the beginning of the free string."""
        return tuple(e for e in self.effects if "hidden_length" in e.laws())

    def free_segment_lengths(self, material: np.ndarray) -> np.ndarray:
        """Return the rest length of a segment of the free string, (...) [m].

        material: (..., P).
        """
        return self.segment_length * self.free_length_ratio(material)

    def free_arc_lengths(self, material: np.ndarray) -> np.ndarray:
        """Return arc lengths of points along the free string, (C, n) [m].

        material: (C, P).
        """
        return self.arc_lengths() * self.free_length_ratio(material)[:, None]

    def point_masses(self, material: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the masses of points and the lengths of string that they represent.

        Parameters
        ----------
        material : ndarray of shape (C, P)
            Material properties.

        Returns
        -------
        masses : ndarray of shape (C, n)
            Mass over nominal mass per length [m].
        cells : ndarray of shape (C, n)
            Length of string that each point represents [m].
        """
        ratio = self.free_length_ratio(material)[:, None]
        cells = np.repeat(self.segment_length * ratio, self.points, axis=1)
        cells[:, -1] *= self.tip_cell
        arguments = {
            "s": self.free_arc_lengths(material),
            "length": self.length * ratio,
        }
        cells[:, -1:] = self.law_sum("tip_length", material, arguments, cells[:, -1:])
        density = np.ones((len(material), self.points))
        masses = cells * self.law_sum("density", material, arguments, density)
        tip_mass = np.zeros((len(material), 1))
        masses[:, -1:] += self.law_sum("tip_mass", material, arguments, tip_mass)
        return masses, cells

    # --- laws ---------------------------------------------------------------

    def uses_argument(self, slots: Sequence[str], names: Sequence[str]) -> bool:
        """Return whether a law in one of the slots takes one of these arguments."""
        for slot in slots:
            for _, arguments, _ in self._laws.get(slot, ()):
                if {*names} & {*arguments}:
                    return True
        return False

    def law_values(
        self, slot: str, material: np.ndarray, arguments: Mapping[str, np.ndarray]
    ) -> Iterator[Any]:
        """Evaluate each law in a slot.

        material: (C, rows). arguments: the slot's arguments by name, (1 or C, M) each.
        """
        for law in self._laws.get(slot, ()):
            yield _evaluate_law(law, material, arguments)

    def law_sum(
        self,
        slot: str,
        material: np.ndarray,
        arguments: Mapping[str, np.ndarray],
        start: np.ndarray,
    ) -> np.ndarray:
        """Add the values of all laws in a slot to an initial value (C, M)."""
        return sum(self.law_values(slot, material, arguments), start)

    def memory_count(self, slot: str) -> int:
        """Count effects with memory in a slot, `moment` or `grasp_moment`."""
        return len(self._laws.get(MEMORY_SLOTS[slot][0], ()))

    def updated_memory(
        self,
        slot: str,
        material: np.ndarray,
        change: np.ndarray,
        before: Sequence[np.ndarray] | None = None,
        duration: float = np.inf,
    ) -> list[np.ndarray]:
        """Update the state of each effect with memory after a change of bending.

        Parameters
        ----------
        slot : str
            Slot of the moment: `moment` or `grasp_moment`.
        material : ndarray of shape (C, rows)
            Material properties.
        change : ndarray of shape (1 or C, M)
            Change of curvature [1/m] or of the grasp's angle [rad].
        before : sequence of ndarray, optional
            States before the change, (1 or C, M) each; zero if not given.
        duration : float
            Duration of the change [s].

        Returns
        -------
        list of ndarray
            States after the change, (1 or C, M) each.
        """
        laws = self._laws.get(MEMORY_SLOTS[slot][0], [])
        known = {"change": change, "dt": np.full((1, 1), duration)}
        states = before or [np.zeros((1, 1))] * len(laws)
        after = []
        for law, memory in zip(laws, states, strict=True):
            after.append(_evaluate_law(law, material, {**known, "memory": memory}))
        return after

    def memory_moments(
        self, slot: str, material: np.ndarray, states: Sequence[np.ndarray]
    ) -> Iterator[Any]:
        """Evaluate the moment of each effect with memory.

        states: in the order of `updated_memory`.
        """
        laws = self._laws.get(MEMORY_SLOTS[slot][1], ())
        for law, memory in zip(laws, states, strict=True):
            yield _evaluate_law(law, material, {"memory": memory})

    @cached_property
    def _laws(self) -> dict[str, list[BoundLaw]]:
        """Laws in each slot."""
        laws: dict[str, list[BoundLaw]] = {}
        for effect in self.effects:
            for slot, law in effect.laws().items():
                arguments = law_arguments(law)
                places = self._material_rows(effect, arguments)
                laws.setdefault(slot, []).append((law, arguments, places))
        return laws

    def _material_rows(
        self, effect: type[StringEffect], arguments: Sequence[str]
    ) -> dict[str, int]:
        """Return the rows of a law's parameters in the material, by name."""
        rows = {}
        for argument in arguments:
            # An effect's own parameter takes precedence over others of the same name.
            for name in (f"{effect.name}.{argument}", argument):
                if name in self.row_names:
                    rows[argument] = self.row_names.index(name)
                    break
        return rows


def _parameter_names(effects: Effects) -> set[str]:
    return {p.name for effect in effects for p in effect.qualified_parameters()}


def _absent_values(effects: Effects) -> np.ndarray:
    """Return the values (P,) at which effects are absent."""
    return np.array([p.start for effect in effects for p in effect.parameters])


def _evaluate_law(
    bound: BoundLaw, material: np.ndarray, arguments: Mapping[str, np.ndarray]
) -> Any:
    """Evaluate a law for all candidates.

    material: (C, rows). arguments: the slot's arguments, (1 or C, M) each.
    """
    law, names, places = bound
    known = {name: material[:, place, None] for name, place in places.items()}
    given = {name: arguments[name] for name in names if name in arguments}
    return law(**given, **known)
