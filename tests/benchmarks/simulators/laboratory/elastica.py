"""A laboratory whose string is a Cosserat rod of PyElastica, kept in a plane.

State, strains, inner forces and turning are PyElastica's; its own loop runs in Python
at a fifth of a millisecond a step, so the same position Verlet steps are compiled here.
The rod is almost unshearable and thin. PyElastica has no damping by rates of strain; it
is added as dampers between neighbouring sections, those in bending implicitly.

Naughton, Sun, Tekinalp, Parthasarathy, Chowdhary and Gazzola, Elastica: a compliant
mechanics environment for soft robotic control (2021). Needs `pyelastica`, an extra.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from elastica.rod.cosserat_rod import (
    CosseratRod,
    _compute_internal_forces,
    _compute_internal_torques,
)
from elastica.rod.data_structures import overload_operator_kinematic_numba
from numba import njit

from tests.benchmarks.simulators.laboratory.hand import Path
from tests.benchmarks.simulators.laboratory.nodal import Nodal
from tests.benchmarks.simulators.laboratory.nodal.dynamics import (
    at_tip,
    grasp_moment,
    load,
    stiffness,
)
from tests.benchmarks.simulators.laboratory.nodal.elements import Mesh
from tests.benchmarks.simulators.laboratory.nodal.motion import rest
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.scene import CHECK, FINE, Moved

MESHES = (32, 48, 72)  # elements, each half as many again
# [m], for the rotary inertia alone: (pi r / wave)^2 = 1.6 % of the kinetic energy of
# waves of 50 mm
RADIUS = 2e-3
# stiffness in shear over that in stretch: as good as none in waves of a hand's length
SHEAR = 20.0
STEP = 0.8  # of the largest stable step, 2 over the fastest frequency
KEPT = 5e-4  # [s] between states that are kept
NODES = 24  # elements of the rod that hangs at rest


@dataclass(frozen=True)
class Positions:
    """Mass points on a uniform grid. t: (K,) [s]. x: (K, N + 1, 2) [m]. length: of the
    rod [m].
    """

    t: np.ndarray
    x: np.ndarray
    length: float

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Positions, interpolated by cubics in time and along the string; see `Moved`."""
        step = self.t[1] - self.t[0]
        in_time = _cubic((times - self.t[0]) / step, len(self.t))
        along = _cubic(arc / self.length * (self.x.shape[1] - 1), self.x.shape[1])
        here = sum(w[:, None, None] * self.x[k] for k, w in zip(*in_time, strict=True))
        return np.asarray(
            sum(w[:, None] * here[:, k] for k, w in zip(*along, strict=True))
        )


def _cubic(place: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Four neighbours (4, M) of places on a grid, and their weights in Lagrange's
    polynomial (4, M).
    """
    first = np.clip(np.floor(place).astype(int) - 1, 0, count - 4)
    x = place - first
    weights = [
        np.prod([(x - j) / (i - j) for j in range(4) if j != i], axis=0)
        for i in range(4)
    ]
    return first + np.arange(4)[:, None], np.stack(weights)


@dataclass(frozen=True)
class Extrapolated:
    """Two meshes of a method of second order, and what they tend to (Richardson).
    ratio: of their elements.
    """

    coarse: Moved
    dense: Moved
    ratio: float

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Positions extrapolated from those of both meshes; see `Moved`."""
        coarse, dense = self.coarse.points(times, arc), self.dense.points(times, arc)
        return dense + (dense - coarse) / (self.ratio**2 - 1)


class Elastica(Nodal):
    """The laboratory whose measurements are PyElastica's; sizes are sought, and trials
    chosen, with the nodal rod.
    """

    likely = 1e-3

    def __init__(self) -> None:
        self._made: tuple[object, dict[int, Positions]] = (None, {})

    def moved(self, rod: Rod, path: Path, level: int) -> Moved:
        """The rod extrapolated from the two finest meshes, and to check from the two
        coarsest; see `Laboratory`.
        """
        if level not in (CHECK, FINE):
            return super().moved(rod, path, level)
        coarse, dense = MESHES[1:] if level == FINE else MESHES[:-1]
        return Extrapolated(
            self._once(rod, path, coarse), self._once(rod, path, dense), dense / coarse
        )

    def _once(self, rod: Rod, path: Path, elements: int) -> Positions:
        """The rod moved; the last one is cached, for two levels ask for one mesh of it."""
        key = rod, path.pose.c.tobytes()
        if self._made[0] != key:
            self._made = (key, {})
        if elements not in self._made[1]:
            self._made[1][elements] = moved(rod, path, elements)
        return self._made[1][elements]


def moved(rod: Rod, path: Path, elements: int) -> Positions:
    """The rod from rest, as the hand takes it along."""
    made, middle = (
        _made(rod, elements),
        (np.arange(elements - 1) + 1) * rod.length / elements,
    )
    bending = np.array([stiffness(s, rod.record) for s in middle])
    shear, segment = SHEAR * rod.axial, rod.length / elements
    # of a section, over the square of its radius of inertia
    turning = shear + 4 * bending.max() / segment**2
    fastest = math.sqrt(
        turning / (RADIUS / 2) ** 2
        + 4 * shear / segment**2
        + rod.plane
        + rod.peg
        + rod.thread
    )
    keep = math.ceil(KEPT * fastest / 2 / STEP)
    count = math.ceil((path.end - path.start) / KEPT)
    t = np.linspace(path.start, path.end, count + 1)
    hand = path.at(np.linspace(path.start, path.end, 2 * count * keep + 1))
    at_rest = rest(Mesh.of(rod, NODES), hand[0])
    _put(
        made, Mesh.of(rod, NODES).at(np.linspace(0, rod.length, elements + 1)) @ at_rest
    )
    x = _run(made, rod, bending, hand, (t[1] - t[0]) / keep, keep, t[0])
    return Positions(t, x, rod.length)


def _made(rod: Rod, elements: int) -> CosseratRod:
    """A straight rod of PyElastica with the masses and stiffnesses of another, per mass
    per length.
    """
    made = CosseratRod.straight_rod(
        elements,
        start=np.zeros(3),
        direction=np.array([1.0, 0.0, 0.0]),
        # d1: about it the rod bends in the plane, d3 is along it
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=rod.length,
        base_radius=RADIUS,
        density=1 / (np.pi * RADIUS**2),
        youngs_modulus=1e9,  # overwritten below
    )
    s = np.linspace(0, rod.length, elements + 1)
    made.mass[:] *= 1 + rod.taper * (s / rod.length - 0.5)
    made.mass[-1] += rod.tip_mass * rod.length
    place = rod.bead_place * elements
    made.mass[int(place)] += (1 - place % 1) * rod.bead_mass * rod.length
    made.mass[int(place) + 1] += (place % 1) * rod.bead_mass * rod.length
    made.shear_matrix[:] = np.diag([SHEAR * rod.axial, SHEAR * rod.axial, rod.axial])[
        ..., None
    ]
    made.rest_kappa[0] = rod.set_curvature
    return made


def _put(made: CosseratRod, places: np.ndarray) -> None:
    """Lay a rod along places (N + 1, 2), its sections across."""
    made.position_collection[:2] = places.T
    along = (
        np.diff(places, axis=0)
        / np.linalg.norm(np.diff(places, axis=0), axis=1)[:, None]
    )
    made.director_collection[:] = 0.0
    made.director_collection[0, 2] = 1.0
    made.director_collection[1, 0], made.director_collection[1, 1] = (
        along[:, 1],
        -along[:, 0],
    )
    made.director_collection[2, 0], made.director_collection[2, 1] = along.T


def _run(
    made: CosseratRod,
    rod: Rod,
    bending: np.ndarray,
    hand: np.ndarray,
    dt: float,
    keep: int,
    begin: float,
) -> np.ndarray:
    """Positions of mass points (K, N + 1, 2), every `keep` steps. hand: (2 K keep + 1,
    8) every half step.
    """
    forces = (
        *(
            made.position_collection,
            made.volume,
            made.lengths,
            made.tangents,
            made.radius,
            made.rest_lengths,
        ),
        *(
            made.rest_voronoi_lengths,
            made.dilatation,
            made.voronoi_dilatation,
            made.director_collection,
            made.sigma,
        ),
        *(
            made.rest_sigma,
            made.shear_matrix,
            made.internal_stress,
            made.internal_forces,
            made.ghost_elems_idx,
        ),
    )
    torques = (
        *(
            made.position_collection,
            made.velocity_collection,
            made.tangents,
            made.lengths,
            made.rest_lengths,
        ),
        *(
            made.director_collection,
            made.rest_voronoi_lengths,
            made.bend_matrix,
            made.rest_kappa,
            made.kappa,
        ),
        *(
            made.voronoi_dilatation,
            made.mass_second_moment_of_inertia,
            made.omega_collection,
            made.internal_stress,
        ),
        *(
            made.internal_couple,
            made.dilatation,
            made.dilatation_rate,
            made.internal_torques,
            made.ghost_voronoi_idx,
        ),
    )
    inertia = made.mass_second_moment_of_inertia[0, 0].copy()
    return _verlet(
        forces, torques, made.mass, inertia, bending, hand, dt, keep, begin, rod.record
    )


@njit(cache=True, error_model="numpy")
def _verlet(
    forces: tuple[np.ndarray, ...],
    torques: tuple[np.ndarray, ...],
    mass: np.ndarray,
    inertia: np.ndarray,
    bending: np.ndarray,
    hand: np.ndarray,
    dt: float,
    keep: int,
    begin: float,
    rod: Rod,
) -> np.ndarray:
    """PyElastica's position Verlet steps of places and directors. Its rods keep their
    volume, and are less stiff when stretched; a string's stiffness is taken to stay: N
    = axial e, M = bending k per unstretched length.
    """
    x, v, directors, omega = forces[0], torques[1], forces[9], torques[12]
    steps, nodes = (len(hand) - 1) // 2, x.shape[1]
    kept, outer = np.empty((steps // keep + 1, nodes, 2)), np.empty((2, nodes))
    kept[0] = x[:2].T
    shear, bend, segment = forces[12].copy(), torques[7], forces[5][0]
    # half an element bends before the grasp
    soft = 1.0 / (1.0 + rod.grasp_stiffness * 0.5 * segment / bending[0])
    turn = 0.0
    for k in range(steps):
        now = hand[2 * k + 1]
        overload_operator_kinematic_numba(0.5 * dt, x, directors, v, omega)
        x[0, 0], x[1, 0] = now[0], now[1]
        forces[12][:] = shear * forces[7]
        _compute_internal_forces(*forces)
        bend[0, 0] = bending * forces[8] ** 3
        _compute_internal_torques(*torques)
        t = begin + (k + 0.5) * dt
        _pushed(
            t,
            dt,
            x,
            v,
            forces[3],
            rod.axial_damping * torques[16],
            forces[14],
            mass,
            segment,
            rod,
            outer,
        )
        turn = _nearest(
            math.atan2(directors[2, 1, 0], directors[2, 0, 0]) - now[6], turn
        )
        _turned(t, dt, turn, omega[0], torques[17][0], inertia, now, soft, segment, rod)
        v[0, 0], v[1, 0] = now[2], now[3]
        overload_operator_kinematic_numba(0.5 * dt, x, directors, v, omega)
        x[0, 0], x[1, 0] = hand[2 * k + 2, 0], hand[2 * k + 2, 1]
        if (k + 1) % keep == 0:
            kept[(k + 1) // keep] = x[:2].T
    return kept


@njit(cache=True, error_model="numpy")
def _pushed(
    t: float,
    dt: float,
    x: np.ndarray,
    v: np.ndarray,
    along: np.ndarray,
    pull: np.ndarray,
    inner: np.ndarray,
    mass: np.ndarray,
    segment: float,
    rod: Rod,
    outer: np.ndarray,
) -> None:
    """Velocities (3, N + 1) after a step, but the hand's. pull: (N,) of dampers along
    the string. inner: (3, N + 1) forces. outer: (2, N + 1), to work in.
    """
    _outer(t, x, v, along, segment, rod, outer)
    for c in range(2):
        outer[c, :-1] += pull * along[c]
        outer[c, 1:] -= pull * along[c]
    for i in range(1, x.shape[1]):
        v[0, i] += dt * ((inner[0, i] + outer[0, i]) / mass[i] + rod.gravity_x)
        v[1, i] += dt * ((inner[1, i] + outer[1, i]) / mass[i] + rod.gravity_y)


@njit(cache=True, error_model="numpy")
def _nearest(turn: float, before: float) -> float:
    """An angle, as many turns on as brings it nearest to one before [rad]: a rod may
    wind about its grasp.
    """
    return turn + 2.0 * math.pi * round((before - turn) / (2.0 * math.pi))


@njit(cache=True, error_model="numpy")
def _turned(
    t: float,
    dt: float,
    turn: float,
    omega: np.ndarray,
    torque: np.ndarray,
    inertia: np.ndarray,
    hand: np.ndarray,
    soft: float,
    segment: float,
    rod: Rod,
) -> None:
    """Rates of turning (N,) after a step. turn: of the first section from the grasp's
    direction [rad]. torque: (N,), to which the grasp's is added. soft: share of the
    grasp's moment that the half element before it passes on.
    """
    torque[0] -= soft * grasp_moment(turn, 0.0, t, rod)
    omega += dt * torque / inertia
    brake = soft * soft * grasp_moment(0.0, 1.0, t, rod)
    _braked(
        omega,
        hand[7],
        dt * brake / inertia[0],
        dt * rod.bending_damping / segment / inertia[0],
    )


@njit(cache=True, error_model="numpy")
def _braked(omega: np.ndarray, hand: float, first: float, between: float) -> None:
    """Rates of turning (N,) [rad/s] after a step in which dampers act, implicitly: of
    the first section against the hand, and of each against its neighbour, both as
    shares of the rate that a step takes away.
    """
    ahead = np.empty_like(omega)
    last = len(omega) - 1
    for e in range(last + 1):
        before, after = (between if e > 0 else first), (between if e < last else 0.0)
        given = hand if e == 0 else omega[e - 1]
        share = 1.0 / (1.0 + before * (1.0 - (ahead[e - 1] if e > 0 else 0.0)) + after)
        ahead[e] = after * share
        omega[e] = (omega[e] + before * given) * share
    for e in range(last - 1, -1, -1):
        omega[e] += ahead[e] * omega[e + 1]


@njit(cache=True, error_model="numpy")
def _outer(
    t: float,
    x: np.ndarray,
    v: np.ndarray,
    tangents: np.ndarray,
    segment: float,
    rod: Rod,
    outer: np.ndarray,
) -> None:
    """Outer forces on the mass points but weight, (2, N + 1), each over the length that
    it stands for.
    """
    last = x.shape[1] - 1
    for i in range(last + 1):
        before, after = max(i - 1, 0), min(i, last - 1)
        tx, ty = (
            tangents[0, before] + tangents[0, after],
            tangents[1, before] + tangents[1, after],
        )
        long = math.sqrt(tx * tx + ty * ty)
        fx, fy = load(
            x[0, i],
            x[1, i],
            v[0, i],
            v[1, i],
            tx / long,
            ty / long,
            i * segment,
            t,
            rod,
        )
        cell = segment if 0 < i < last else 0.5 * segment
        outer[0, i], outer[1, i] = cell * fx, cell * fy
    fx, fy = at_tip(x[0, last], x[1, last], v[0, last], v[1, last], t, rod)
    outer[0, last] += fx
    outer[1, last] += fy
