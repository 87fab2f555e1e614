"""The nodal laboratory's rod alone: rest, waves, energy, order, and a solver of SciPy.
Compiling it takes 15 s.
"""

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp
from scipy.special import jn_zeros

from tests.benchmarks.simulators.laboratory.hand import Path
from tests.benchmarks.simulators.laboratory.nodal.dynamics import State, forces
from tests.benchmarks.simulators.laboratory.nodal.elements import Mesh
from tests.benchmarks.simulators.laboratory.nodal.motion import moved, rest
from tests.benchmarks.simulators.laboratory.rod import Rod

pytestmark = pytest.mark.long
LENGTH, G = 0.3, 9.81
PLAIN = Rod(LENGTH, 700.0, 0.03, 6e-3, 5e-6, 0.3, 0.2, 0.07, 1e-4)
FREE = PLAIN._replace(
    axial_damping=0.0,
    bending_damping=0.0,
    linear_drag=0.0,
    quadratic_drag=0.0,
    grasp_damping=0.0,
)
DOWN, LEVEL = -np.pi / 2, 0.0


def held(theta):
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, theta, 0.0])


def swung(until=0.5, reach=0.1, turn=0.8):
    """A hand that moves for a fifth of a second, with the least jerk, and stops."""
    t = np.linspace(0, until, round(until / 0.005) + 1)
    x = np.clip((t - 0.02) / 0.2, 0, 1)
    way = 10 * x**3 - 15 * x**4 + 6 * x**5
    return Path.through(t, np.stack([reach * way, 0 * way, DOWN + turn * way], axis=-1))


def energy(motion, path):
    """Kinetic and potential energy over mass per length, (K,) [m3/s2], from the
    definitions of stretch and turn.
    """
    mesh, rod = motion.mesh, motion.mesh.rod
    q, v = motion.q, motion.v
    e = np.arange(mesh.elements)[:, None] * 2 + np.arange(4)
    first, second = (
        np.einsum("gi,keic->kegc", mesh.shapes[:, k], q[:, e]) for k in (1, 2)
    )
    square = np.sum(first**2, axis=-1)
    turn = (first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]) / square
    inner = 0.5 * rod.axial * (np.sqrt(square) - 1) ** 2 + 0.5 * rod.bending * turn**2
    angle = np.unwrap(np.arctan2(q[:, 1, 1], q[:, 1, 0]) - path.at(motion.t)[:, 6])
    weight = -np.einsum("dc,kdc->k", mesh.weight, q)
    kinetic = 0.5 * np.einsum("kdc,de,kec->k", v, mesh.mass, v)
    return (
        kinetic
        + inner @ mesh.weights @ np.ones(mesh.elements)
        + 0.5 * rod.grasp_stiffness * angle**2
        + weight
    )


def test_a_hanging_rod_is_as_much_longer_as_its_weight_stretches_it():
    tip = rest(Mesh.of(PLAIN._replace(tip_mass=0.4), 6), held(DOWN))[-2]
    assert tip == pytest.approx(
        [0.0, -LENGTH - G * LENGTH**2 / PLAIN.axial * (0.5 + 0.4)], abs=1e-9
    )


@pytest.mark.parametrize("curvature", [0.0, 3.0])
def test_a_rod_held_out_level_hangs_as_the_heavy_elastica_does(curvature):
    stiff = PLAIN._replace(axial=1e5, bending=0.05, set_curvature=curvature)

    def elastica(s, y):  # angle, moment; beyond s hangs the weight of the rest
        return np.stack(
            [y[1] / stiff.bending + curvature, G * (LENGTH - s) * np.cos(y[0])]
        )

    def ends(a, b):
        return np.array([a[1] - stiff.grasp_stiffness * a[0], b[1]])

    s = np.linspace(0, LENGTH, 41)
    angle = solve_bvp(elastica, ends, s, np.stack([-s, 0 * s]), tol=1e-9).sol(
        np.linspace(0, LENGTH, 2001)
    )[0]
    true = np.trapezoid([np.cos(angle), np.sin(angle)], dx=LENGTH / 2000, axis=1)
    assert rest(Mesh.of(stiff, 12), held(LEVEL))[-2] == pytest.approx(true, abs=2e-5)


def test_a_limp_chain_swings_at_the_zeros_of_a_bessel_function():
    # 1e-6 would raise the fourth tone by 0.3 %
    limp = FREE._replace(bending=1e-7, grasp_stiffness=1e-6, axial=1e4)
    motion = moved(limp, swung(2.5, reach=1e-4, turn=0.0), 10, 1e-3)
    t = np.linspace(0.3, 2.5, 1001)
    x = motion.points(t, np.array([LENGTH]))[:, 0, 0] - 1e-4

    def left(gravity):
        # the jerk sounds the fifth tone, too
        phase = np.outer(jn_zeros(0, 6), t) / 2 * np.sqrt(gravity / LENGTH)
        waves = np.concatenate([np.cos(phase), np.sin(phase)]).T
        return np.std(x - waves @ np.linalg.lstsq(waves, x, rcond=None)[0]) / np.std(x)

    assert left(G) < 0.03
    assert min(left(0.97 * G), left(1.03 * G)) > 5 * left(G)


def test_energy_stays_without_losses_and_never_rises_with_them():
    path = swung()
    kept, lost = (energy(moved(rod, path, 8, 2e-4), path) for rod in (FREE, PLAIN))
    after = slice(1150, None)  # the hand has stopped
    floor = energy(moved(FREE, (still := swung(reach=0.0, turn=0.0)), 8, 2e-3), still)[
        0
    ]
    assert np.ptp(kept[after]) < 2e-3 * (kept[after].max() - floor)
    assert np.diff(lost[after]).max() < 1e-9
    assert lost[-1] - floor < 0.9 * (lost[after][0] - floor)


def test_a_rod_that_winds_about_its_grasp_is_turned_back_by_all_of_it():
    """The energy of the grasp's spring goes with the angle by which it was wound, more
    than half a turn.
    """
    path, rod = swung(turn=5.5), FREE._replace(gravity_y=0.0)
    motion = moved(rod, path, 8, 1e-4)
    angle = np.unwrap(
        np.arctan2(motion.q[:, 1, 1], motion.q[:, 1, 0]) - path.at(motion.t)[:, 6]
    )
    kept = energy(motion, path)[2300:]  # the hand has stopped
    assert np.abs(angle).max() > 3.3
    assert np.ptp(kept) < 2e-3 * kept.max()


def test_the_order_in_elements_and_in_steps():
    path, t = swung(), np.linspace(0, 0.5, 51)

    def tip(elements, step):
        return moved(PLAIN, path, elements, step).points(t, np.array([LENGTH]))[:, 0]

    true = tip(32, 2e-4)
    coarse, fine = (np.linalg.norm(tip(n, 2e-4) - true, axis=1).max() for n in (8, 16))
    assert fine < 2e-5
    assert coarse / fine > 2**3.5
    true = tip(8, 1e-4)
    coarse, fine = (
        np.linalg.norm(tip(8, step) - true, axis=1).max() for step in (2e-3, 1e-3)
    )
    assert coarse / fine > 2**2.5


@pytest.mark.parametrize(
    "rod",
    [
        PLAIN,
        PLAIN._replace(rub=0.01, rub_curvature=2.0, relaxing=5e-3, relaxation=0.05),
    ],
)
def test_steps_follow_the_same_equations_as_a_solver_of_scipy(rod):
    path, mesh = swung(0.3), Mesh.of(rod, 4)
    parts, still = (rod.record, mesh.compiled), np.zeros((*mesh.places.shape, 2))
    # [s], over which inner states are taken to change
    begun, small = rest(mesh, path.at(np.zeros(1))[0]), 1e-9

    def rates(t, y):
        q, v = y[: 2 * begun.size].reshape(2, *begun.shape)
        state, after, hand = (
            y[2 * begun.size :].reshape(still.shape),
            still.copy(),
            path.at(np.array([t]))[0],
        )
        q[0], v[0] = hand[:2], hand[2:4]
        force = (
            forces(t, State(q, v, state, small, 0.0), hand, *parts, after) + mesh.weight
        )
        a = np.zeros_like(q)
        a[0] = hand[4:6]
        a[1:] = np.linalg.solve(
            mesh.mass[1:, 1:], force[1:] - np.outer(mesh.mass[1:, 0], a[0])
        )
        return np.concatenate([v.ravel(), a.ravel(), ((after - state) / small).ravel()])

    t = np.linspace(0, 0.3, 13)
    y = np.concatenate([begun.ravel(), np.zeros(begun.size + still.size)])
    solved = solve_ivp(rates, (0, 0.3), y, "LSODA", t, rtol=1e-8, atol=1e-9).y.T[
        :, : begun.size
    ]
    tip = moved(rod, path, 4, 1e-4).points(t, np.array([LENGTH]))[:, 0]
    assert (
        np.linalg.norm(solved.reshape(-1, *begun.shape)[:, -2] - tip, axis=1).max()
        < 5e-6
    )
