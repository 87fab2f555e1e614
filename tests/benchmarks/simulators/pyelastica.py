"""A Cosserat rod of PyElastica, kept in a plane, as a reference simulator.

State, strains, inner forces and rotation are PyElastica's. Its own loop runs in Python
at a fifth of a millisecond a step, so the same position Verlet steps are compiled here.
The rod is almost unshearable and thin. PyElastica has no damping by rates of strain; it
is added as dampers between neighbouring sections, those in bending implicitly.

Naughton, Sun, Tekinalp, Parthasarathy, Chowdhary and Gazzola, Elastica: a compliant
mechanics environment for soft robotic control (2021). Needs the package `pyelastica`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from elastica.rod.cosserat_rod import (
    CosseratRod,
    _compute_internal_forces,
    _compute_internal_torques,
)
from elastica.rod.data_structures import overload_operator_kinematic_numba
from numba import njit

from tests.benchmarks.simulators.causes import LIBRARY_CAUSES, OUTSIDE_CAUSES
from tests.benchmarks.simulators.hand import GraspPath
from tests.benchmarks.simulators.nodal.elements import Mesh
from tests.benchmarks.simulators.nodal.loads import (
    bending_stiffness,
    grasp_moment,
    load,
    tip_force,
)
from tests.benchmarks.simulators.nodal.motion import rest_coordinates
from tests.benchmarks.simulators.nodal.simulator import Nodal
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import Fidelity, StringMotion

# Elements of two meshes of a method of second order, which are extrapolated.
MESHES = {Fidelity.CHECK: (32, 48), Fidelity.FINAL: (48, 72)}
# It affects the rotary inertia alone, 1.6 % of the kinetic energy of waves of 50 mm.
RADIUS_M = 2e-3
SHEAR_RATIO = 20.0  # stiffness in shear over that in stretch: almost unshearable
STEP_SHARE = 0.8  # share of the largest stable step
SAMPLE_S = 5e-4  # time between states that are kept
REST_ELEMENTS = 24  # elements of the nodal rod that gives the state at rest
# The moment of PyElastica's rod is linear in its turn and has no memory.
UNSUPPORTED = ("nonlinear_bending", "maxwell_slip", "standard_linear_solid")


@dataclass(frozen=True)
class MassPoints:
    """Mass points on a uniform grid; see `StringMotion`.

    Parameters
    ----------
    t : (K,) [s]
    x : (K, N + 1, 2) [m]
    length : of the rod [m]
    """

    t: np.ndarray
    x: np.ndarray
    length: float

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Return positions, interpolated by cubics in time and along the string."""
        samples, nodes = self.x.shape[:2]
        time_place = (times - self.t[0]) / (self.t[1] - self.t[0])
        arc_place = arc / self.length * (nodes - 1)
        first_sample, time_weights = _cubic_weights(time_place, samples)
        first_node, arc_weights = _cubic_weights(arc_place, nodes)
        at_times = np.zeros((len(times), nodes, 2))
        for i in range(4):
            at_times += time_weights[i, :, None, None] * self.x[first_sample + i]
        points = np.zeros((len(times), len(arc), 2))
        for i in range(4):
            points += arc_weights[i, :, None] * at_times[:, first_node + i]
        return points


def _cubic_weights(place: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first of four neighbours (M,) on a grid, and their weights (4, M).

    The weights are Lagrange's.
    """
    first = np.clip(np.floor(place).astype(int) - 1, 0, count - 4)
    x = place - first
    weights = np.ones((4, len(place)))
    for i in range(4):
        for j in range(4):
            if j != i:
                weights[i] *= (x - j) / (i - j)
    return first, weights


@dataclass(frozen=True)
class Extrapolated:
    """The limit of two meshes of a method of second order (Richardson).

    `ratio` is that of their numbers of elements.
    """

    coarse: StringMotion
    fine: StringMotion
    ratio: float

    def points(self, times: np.ndarray, arc: np.ndarray) -> np.ndarray:
        """Return extrapolated positions; see `StringMotion`."""
        coarse = self.coarse.points(times, arc)
        fine = self.fine.points(times, arc)
        return fine + (fine - coarse) / (self.ratio**2 - 1)


class PyElastica(Nodal):
    """The simulator whose measurements are PyElastica's.

    Sizes are searched, and casts are chosen, with the nodal rod.
    """

    screening_tolerance: ClassVar[float] = 1e-3
    causes = tuple(
        cause
        for cause in (*LIBRARY_CAUSES, *OUTSIDE_CAUSES)
        if cause.name not in UNSUPPORTED
    )

    def __init__(self) -> None:
        """Start without a kept motion."""
        self._last: tuple[object, dict[int, MassPoints]] = (None, {})

    def move(self, rod: Rod, path: GraspPath, fidelity: Fidelity) -> StringMotion:
        """Simulate the rod; see `Simulator.move`."""
        if fidelity not in MESHES:
            return super().move(rod, path, fidelity)
        coarse, fine = MESHES[fidelity]
        coarse_motion = self._simulate_once(rod, path, coarse)
        fine_motion = self._simulate_once(rod, path, fine)
        return Extrapolated(coarse_motion, fine_motion, fine / coarse)

    def _simulate_once(self, rod: Rod, path: GraspPath, elements: int) -> MassPoints:
        """Simulate a mesh, or return the kept motion.

        Both fidelities use one mesh.
        """
        key = rod, path.pose.c.tobytes()
        if self._last[0] != key:
            self._last = (key, {})
        motions = self._last[1]
        if elements not in motions:
            motions[elements] = simulate_cosserat_rod(rod, path, elements)
        return motions[elements]


def simulate_cosserat_rod(rod: Rod, path: GraspPath, elements: int) -> MassPoints:
    """Simulate a rod that starts from rest and follows the grasp."""
    cosserat = _make_rod(rod, elements)
    segment = rod.length / elements
    hinges = (np.arange(elements - 1) + 1) * segment
    bending = np.array([bending_stiffness(s, rod.record) for s in hinges])
    shear = SHEAR_RATIO * rod.axial
    turning = shear + 4 * bending.max() / segment**2
    turning /= (RADIUS_M / 2) ** 2  # squared frequency of a section
    obstacles = rod.plane + rod.peg + rod.thread
    fastest = math.sqrt(turning + 4 * shear / segment**2 + obstacles)
    steps_per_sample = math.ceil(SAMPLE_S * fastest / 2 / STEP_SHARE)
    samples = math.ceil((path.end - path.start) / SAMPLE_S)
    t = np.linspace(path.start, path.end, samples + 1)
    half_steps = 2 * samples * steps_per_sample
    hand = path.states(np.linspace(path.start, path.end, half_steps + 1))

    mesh = Mesh.of_rod(rod, REST_ELEMENTS)
    nodes = mesh.position_weights(np.linspace(0, rod.length, elements + 1))
    _lay(cosserat, nodes @ rest_coordinates(mesh, hand[0]))
    dt = (t[1] - t[0]) / steps_per_sample
    x = _run(cosserat, rod, bending, hand, dt, steps_per_sample, t[0])
    return MassPoints(t, x, rod.length)


def _make_rod(rod: Rod, elements: int) -> CosseratRod:
    """Make a straight rod of PyElastica with a rod's masses and stiffnesses."""
    cosserat = CosseratRod.straight_rod(
        elements,
        start=np.zeros(3),
        direction=np.array([1.0, 0.0, 0.0]),
        # d1, about which the rod bends in the plane; d3 is along it
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=rod.length,
        base_radius=RADIUS_M,
        density=1 / (np.pi * RADIUS_M**2),
        youngs_modulus=1e9,  # overwritten below
    )
    s = np.linspace(0, rod.length, elements + 1)
    cosserat.mass[:] *= 1 + rod.taper * (s / rod.length - 0.5)
    cosserat.mass[-1] += rod.tip_mass * rod.length
    place = rod.bead_place / rod.length * elements
    bead = rod.bead_mass * rod.length
    cosserat.mass[int(place)] += (1 - place % 1) * bead
    cosserat.mass[int(place) + 1] += (place % 1) * bead
    shear = SHEAR_RATIO * rod.axial
    cosserat.shear_matrix[:] = np.diag([shear, shear, rod.axial])[..., None]
    cosserat.rest_kappa[0] = rod.rest_curvature
    return cosserat


def _lay(cosserat: CosseratRod, places: np.ndarray) -> None:
    """Lay a rod along places (N + 1, 2), its sections across."""
    cosserat.position_collection[:2] = places.T
    steps = np.diff(places, axis=0)
    along = (steps / np.linalg.norm(steps, axis=1)[:, None]).T
    directors = cosserat.director_collection
    directors[:] = 0.0
    directors[0, 2] = 1.0
    directors[1, 0], directors[1, 1] = along[1], -along[0]
    directors[2, 0], directors[2, 1] = along


def _run(
    cosserat: CosseratRod,
    rod: Rod,
    bending: np.ndarray,
    hand: np.ndarray,
    dt: float,
    steps_per_sample: int,
    begin: float,
) -> np.ndarray:
    """Return positions of mass points (K, N + 1, 2).

    `hand` (2 K steps_per_sample + 1, 8) is given at every half step.
    """
    force_arguments = (
        cosserat.position_collection,
        cosserat.volume,
        cosserat.lengths,
        cosserat.tangents,
        cosserat.radius,
        cosserat.rest_lengths,
        cosserat.rest_voronoi_lengths,
        cosserat.dilatation,
        cosserat.voronoi_dilatation,
        cosserat.director_collection,
        cosserat.sigma,
        cosserat.rest_sigma,
        cosserat.shear_matrix,
        cosserat.internal_stress,
        cosserat.internal_forces,
        cosserat.ghost_elems_idx,
    )
    torque_arguments = (
        cosserat.position_collection,
        cosserat.velocity_collection,
        cosserat.tangents,
        cosserat.lengths,
        cosserat.rest_lengths,
        cosserat.director_collection,
        cosserat.rest_voronoi_lengths,
        cosserat.bend_matrix,
        cosserat.rest_kappa,
        cosserat.kappa,
        cosserat.voronoi_dilatation,
        cosserat.mass_second_moment_of_inertia,
        cosserat.omega_collection,
        cosserat.internal_stress,
        cosserat.internal_couple,
        cosserat.dilatation,
        cosserat.dilatation_rate,
        cosserat.internal_torques,
        cosserat.ghost_voronoi_idx,
    )
    inertia = cosserat.mass_second_moment_of_inertia[0, 0].copy()
    return _integrate(
        force_arguments,
        torque_arguments,
        cosserat.mass,
        inertia,
        bending,
        hand,
        dt,
        steps_per_sample,
        begin,
        rod.record,
    )


@njit(cache=True, error_model="numpy")
def _integrate(
    force_arguments: tuple[np.ndarray, ...],
    torque_arguments: tuple[np.ndarray, ...],
    mass: np.ndarray,
    inertia: np.ndarray,
    bending: np.ndarray,
    hand: np.ndarray,
    dt: float,
    steps_per_sample: int,
    begin: float,
    rod: Rod,
) -> np.ndarray:
    """Take PyElastica's position Verlet steps.

    Its rods keep their volume, and are less stiff when stretched; a string's stiffness
    is taken to stay: N = axial e, M = bending k per unstretched length.
    """
    x, tangents, segment = force_arguments[0], force_arguments[3], force_arguments[5][0]
    dilatation, voronoi_dilatation = force_arguments[7], force_arguments[8]
    directors, shear_matrix = force_arguments[9], force_arguments[12]
    inner_forces = force_arguments[14]
    v = torque_arguments[1]
    bend_matrix = torque_arguments[7]
    omega = torque_arguments[12]
    dilatation_rate, inner_torques = torque_arguments[16], torque_arguments[17]

    steps = (len(hand) - 1) // 2
    nodes = x.shape[1]
    positions = np.empty((steps // steps_per_sample + 1, nodes, 2))
    positions[0] = x[:2].T
    outer = np.empty((2, nodes))
    shear = shear_matrix.copy()
    # Half an element bends before the grasp, and passes on this share of its moment.
    passed_on = 1.0 / (1.0 + rod.grasp_stiffness * 0.5 * segment / bending[0])
    turn = 0.0
    for k in range(steps):
        middle = hand[2 * k + 1]
        overload_operator_kinematic_numba(0.5 * dt, x, directors, v, omega)
        x[0, 0], x[1, 0] = middle[0], middle[1]
        shear_matrix[:] = shear * dilatation
        _compute_internal_forces(*force_arguments)
        bend_matrix[0, 0] = bending * voronoi_dilatation**3
        _compute_internal_torques(*torque_arguments)
        t = begin + (k + 0.5) * dt
        tension = rod.axial_damping * dilatation_rate
        _update_velocities(
            t, dt, x, v, tangents, tension, inner_forces, mass, segment, rod, outer
        )
        angle = math.atan2(directors[2, 1, 0], directors[2, 0, 0]) - middle[6]
        turn = _nearest_angle(angle, turn)
        _update_rotation_rates(
            t,
            dt,
            turn,
            omega[0],
            inner_torques[0],
            inertia,
            middle,
            passed_on,
            segment,
            rod,
        )
        v[0, 0], v[1, 0] = middle[2], middle[3]
        overload_operator_kinematic_numba(0.5 * dt, x, directors, v, omega)
        x[0, 0], x[1, 0] = hand[2 * k + 2, 0], hand[2 * k + 2, 1]
        if (k + 1) % steps_per_sample == 0:
            positions[(k + 1) // steps_per_sample] = x[:2].T
    return positions


@njit(cache=True, error_model="numpy")
def _update_velocities(
    t: float,
    dt: float,
    x: np.ndarray,
    v: np.ndarray,
    tangents: np.ndarray,
    tension: np.ndarray,
    inner: np.ndarray,
    mass: np.ndarray,
    segment: float,
    rod: Rod,
    outer: np.ndarray,
) -> None:
    """Update the velocities (3, N + 1), but for the hand's.

    `tension` (N,) is that of dampers along the string. `inner` (3, N + 1) holds forces.
    `outer` (2, N + 1) is working space.
    """
    _outer_forces(t, x, v, tangents, segment, rod, outer)
    for c in range(2):
        outer[c, :-1] += tension * tangents[c]
        outer[c, 1:] -= tension * tangents[c]
    for i in range(1, x.shape[1]):
        v[0, i] += dt * ((inner[0, i] + outer[0, i]) / mass[i] + rod.gravity_x)
        v[1, i] += dt * ((inner[1, i] + outer[1, i]) / mass[i] + rod.gravity_y)


@njit(cache=True, error_model="numpy")
def _nearest_angle(angle: float, before: float) -> float:
    """Return an angle plus the whole turns that bring it nearest to the last [rad]."""
    return angle + 2.0 * math.pi * round((before - angle) / (2.0 * math.pi))


@njit(cache=True, error_model="numpy")
def _update_rotation_rates(
    t: float,
    dt: float,
    turn: float,
    omega: np.ndarray,
    torque: np.ndarray,
    inertia: np.ndarray,
    hand: np.ndarray,
    passed_on: float,
    segment: float,
    rod: Rod,
) -> None:
    """Update the rates of rotation (N,).

    `turn` is that of the first section from the grasp's direction [rad]. The grasp's
    torque is added to `torque` (N,). `passed_on` is the share of the grasp's moment
    that the half element before the first section passes on.
    """
    torque[0] -= passed_on * grasp_moment(turn, 0.0, t, rod)
    omega += dt * torque / inertia
    grasp_brake = passed_on * passed_on * grasp_moment(0.0, 1.0, t, rod)
    first = dt * grasp_brake / inertia[0]
    between = dt * rod.bending_damping / segment / inertia[0]
    _damp_rotation(omega, hand[7], first, between)


@njit(cache=True, error_model="numpy")
def _damp_rotation(
    omega: np.ndarray, hand: float, first: float, between: float
) -> None:
    """Apply dampers implicitly to rates of rotation (N,) [rad/s].

    The first section is damped against the hand, each other against its neighbour.
    `first` and `between` are shares of the rate that a step removes.
    """
    ahead = np.empty_like(omega)
    last = len(omega) - 1
    for e in range(last + 1):
        before = between if e > 0 else first
        after = between if e < last else 0.0
        neighbour = hand if e == 0 else omega[e - 1]
        eliminated = ahead[e - 1] if e > 0 else 0.0
        share = 1.0 / (1.0 + before * (1.0 - eliminated) + after)
        ahead[e] = after * share
        omega[e] = (omega[e] + before * neighbour) * share
    for e in range(last - 1, -1, -1):
        omega[e] += ahead[e] * omega[e + 1]


@njit(cache=True, error_model="numpy")
def _outer_forces(
    t: float,
    x: np.ndarray,
    v: np.ndarray,
    tangents: np.ndarray,
    segment: float,
    rod: Rod,
    outer: np.ndarray,
) -> None:
    """Write the outer forces on the mass points but weight to `outer` (2, N + 1)."""
    last = x.shape[1] - 1
    for i in range(last + 1):
        before, after = max(i - 1, 0), min(i, last - 1)
        tx = tangents[0, before] + tangents[0, after]
        ty = tangents[1, before] + tangents[1, after]
        norm = math.sqrt(tx * tx + ty * ty)
        tx, ty = tx / norm, ty / norm
        fx, fy = load(x[0, i], x[1, i], v[0, i], v[1, i], tx, ty, i * segment, t, rod)
        cell = segment if 0 < i < last else 0.5 * segment
        outer[0, i], outer[1, i] = cell * fx, cell * fy
    fx, fy = tip_force(x[0, last], x[1, last], v[0, last], v[1, last], t, rod)
    outer[0, last] += fx
    outer[1, last] += fy
