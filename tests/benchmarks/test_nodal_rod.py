"""The nodal rod alone: rest, waves, energy, order of convergence, and SciPy.

It compiles for 15 s.
"""

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp
from scipy.special import jn_zeros

from tests.benchmarks.simulators.hand import GraspPath
from tests.benchmarks.simulators.nodal.assembly import State, all_forces
from tests.benchmarks.simulators.nodal.elements import Mesh
from tests.benchmarks.simulators.nodal.motion import rest_coordinates, simulate_rod
from tests.benchmarks.simulators.rod import Rod

pytestmark = pytest.mark.long
LENGTH, GRAVITY = 0.3, 9.81
PLAIN = Rod(LENGTH, 700.0, 0.03, 6e-3, 5e-6, 0.3, 0.2, 0.07, 1e-4)
LOSSLESS = PLAIN._replace(
    axial_damping=0.0,
    bending_damping=0.0,
    linear_drag=0.0,
    quadratic_drag=0.0,
    grasp_damping=0.0,
)
WITH_MEMORY = PLAIN._replace(
    friction=0.01,
    friction_curvature=2.0,
    relaxing_stiffness=5e-3,
    relaxation_time=0.05,
)
DOWN, LEVEL = -np.pi / 2, 0.0


def still_hand(theta):
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, theta, 0.0])


def swing(until=0.5, reach=0.1, turn=0.8):
    """Move the hand for a fifth of a second with the least jerk, and stop it."""
    t = np.linspace(0, until, round(until / 0.005) + 1)
    x = np.clip((t - 0.02) / 0.2, 0, 1)
    progress = 10 * x**3 - 15 * x**4 + 6 * x**5
    pose = [reach * progress, 0 * progress, DOWN + turn * progress]
    return GraspPath.fit(t, np.stack(pose, axis=-1))


def grasp_angle(motion, path):
    """Return the angle of the first tangent from the grasp's direction, (K,) [rad]."""
    tangent = np.unwrap(np.arctan2(motion.q[:, 1, 1], motion.q[:, 1, 0]))
    return tangent - path.states(motion.t)[:, 6]


def energy(motion, path):
    """Return kinetic and potential energy over mass per length, (K,) [m3/s2].

    They follow from the definitions of stretch and turn.
    """
    mesh, rod = motion.mesh, motion.mesh.rod
    q, v = motion.q, motion.v
    coordinates = np.arange(mesh.elements)[:, None] * 2 + np.arange(4)
    first = np.einsum("gi,keic->kegc", mesh.shapes[:, 1], q[:, coordinates])
    second = np.einsum("gi,keic->kegc", mesh.shapes[:, 2], q[:, coordinates])
    square = np.sum(first**2, axis=-1)
    turn = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    turn /= square
    inner = 0.5 * rod.axial * (np.sqrt(square) - 1) ** 2 + 0.5 * rod.bending * turn**2
    elastic = inner @ mesh.weights @ np.ones(mesh.elements)
    grasp = 0.5 * rod.grasp_stiffness * grasp_angle(motion, path) ** 2
    height = -np.einsum("dc,kdc->k", mesh.weight, q)
    kinetic = 0.5 * np.einsum("kdc,de,kec->k", v, mesh.mass, v)
    return kinetic + elastic + grasp + height


def test_a_hanging_rod_is_as_much_longer_as_its_weight_stretches_it():
    mesh = Mesh.of_rod(PLAIN._replace(tip_mass=0.4), 6)
    tip = rest_coordinates(mesh, still_hand(DOWN))[-2]
    stretch = GRAVITY * LENGTH**2 / PLAIN.axial * (0.5 + 0.4)
    assert tip == pytest.approx([0.0, -LENGTH - stretch], abs=1e-9)


@pytest.mark.parametrize("curvature", [0.0, 3.0])
def test_a_rod_held_out_level_hangs_as_the_heavy_elastica_does(curvature):
    rod = PLAIN._replace(axial=1e5, bending=0.05, rest_curvature=curvature)

    def elastica(s, y):  # angle and moment; the weight of the rest hangs beyond s
        weight = GRAVITY * (LENGTH - s) * np.cos(y[0])
        return np.stack([y[1] / rod.bending + curvature, weight])

    def ends(a, b):
        return np.array([a[1] - rod.grasp_stiffness * a[0], b[1]])

    s = np.linspace(0, LENGTH, 41)
    solution = solve_bvp(elastica, ends, s, np.stack([-s, 0 * s]), tol=1e-9).sol
    angle = solution(np.linspace(0, LENGTH, 2001))[0]
    tangent = [np.cos(angle), np.sin(angle)]
    true_tip = np.trapezoid(tangent, dx=LENGTH / 2000, axis=1)
    tip = rest_coordinates(Mesh.of_rod(rod, 12), still_hand(LEVEL))[-2]
    assert tip == pytest.approx(true_tip, abs=2e-5)


def test_a_limp_chain_swings_at_the_zeros_of_a_bessel_function():
    # A bending stiffness of 1e-6 would raise the fourth tone by 0.3 %.
    limp = LOSSLESS._replace(bending=1e-7, grasp_stiffness=1e-6, axial=1e4)
    motion = simulate_rod(limp, swing(2.5, reach=1e-4, turn=0.0), 10, 1e-3)
    t = np.linspace(0.3, 2.5, 1001)
    x = motion.points(t, np.array([LENGTH]))[:, 0, 0] - 1e-4

    def residual(gravity):
        tones = jn_zeros(0, 6)  # the jerk excites the fifth, too
        phase = np.outer(tones, t) / 2 * np.sqrt(gravity / LENGTH)
        waves = np.concatenate([np.cos(phase), np.sin(phase)]).T
        fit = waves @ np.linalg.lstsq(waves, x, rcond=None)[0]
        return np.std(x - fit) / np.std(x)

    assert residual(GRAVITY) < 0.03
    wrong = min(residual(0.97 * GRAVITY), residual(1.03 * GRAVITY))
    assert wrong > 5 * residual(GRAVITY)


def test_energy_stays_without_losses_and_never_rises_with_them():
    path = swing()
    kept = energy(simulate_rod(LOSSLESS, path, 8, 2e-4), path)
    lost = energy(simulate_rod(PLAIN, path, 8, 2e-4), path)
    stopped = slice(1150, None)
    still = swing(reach=0.0, turn=0.0)
    lowest = energy(simulate_rod(LOSSLESS, still, 8, 2e-3), still)[0]
    assert np.ptp(kept[stopped]) < 2e-3 * (kept[stopped].max() - lowest)
    assert np.diff(lost[stopped]).max() < 1e-9
    assert lost[-1] - lowest < 0.9 * (lost[stopped][0] - lowest)


def test_a_rod_that_winds_about_its_grasp_is_turned_back_by_all_of_it():
    """The energy of the grasp's spring counts angles beyond half a turn in full."""
    path, rod = swing(turn=5.5), LOSSLESS._replace(gravity_y=0.0)
    motion = simulate_rod(rod, path, 8, 1e-4)
    kept = energy(motion, path)[2300:]  # the hand has stopped
    assert np.abs(grasp_angle(motion, path)).max() > 3.3
    assert np.ptp(kept) < 2e-3 * kept.max()


def test_the_order_in_elements_and_in_steps():
    path, t = swing(), np.linspace(0, 0.5, 51)

    def tip(elements, step):
        motion = simulate_rod(PLAIN, path, elements, step)
        return motion.points(t, np.array([LENGTH]))[:, 0]

    def error(tips, true):
        return np.linalg.norm(tips - true, axis=1).max()

    true = tip(32, 2e-4)
    coarse, fine = error(tip(8, 2e-4), true), error(tip(16, 2e-4), true)
    assert fine < 2e-5
    assert coarse / fine > 2**3.5
    true = tip(8, 1e-4)
    coarse, fine = error(tip(8, 2e-3), true), error(tip(8, 1e-3), true)
    assert coarse / fine > 2**2.5


@pytest.mark.parametrize("rod", [PLAIN, WITH_MEMORY])
def test_steps_follow_the_same_equations_as_a_solver_of_scipy(rod):
    path, mesh = swing(0.3), Mesh.of_rod(rod, 4)
    string = rod.record, mesh.as_elements
    no_memory = np.zeros((*mesh.places.shape, 2))
    start = rest_coordinates(mesh, path.states(np.zeros(1))[0])
    lapse = 1e-9  # [s] over which the memory is taken to change

    def rates(t, y):
        q, v = y[: 2 * start.size].reshape(2, *start.shape)
        memory = y[2 * start.size :].reshape(no_memory.shape)
        after = memory.copy()
        hand = path.states(np.array([t]))[0]
        q[0], v[0] = hand[:2], hand[2:4]
        state = State(q, v, memory, lapse, 0.0)
        force = all_forces(t, state, hand, *string, after) + mesh.weight
        a = np.zeros_like(q)
        a[0] = hand[4:6]
        free_force = force[1:] - np.outer(mesh.mass[1:, 0], a[0])
        a[1:] = np.linalg.solve(mesh.mass[1:, 1:], free_force)
        memory_rate = (after - memory) / lapse
        return np.concatenate([v.ravel(), a.ravel(), memory_rate.ravel()])

    t = np.linspace(0, 0.3, 13)
    y = np.concatenate([start.ravel(), np.zeros(start.size + no_memory.size)])
    solution = solve_ivp(rates, (0, 0.3), y, "LSODA", t, rtol=1e-8, atol=1e-9)
    solved = solution.y.T[:, : start.size].reshape(-1, *start.shape)[:, -2]
    motion = simulate_rod(rod, path, 4, 1e-4)
    tip = motion.points(t, np.array([LENGTH]))[:, 0]
    assert np.linalg.norm(solved - tip, axis=1).max() < 5e-6
