"""Steps of stiff strings are stable, and as accurate as small explicit steps."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine import rotation
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.hand import HandMotion, resample_hand_motion
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.string import PAPER_EFFECTS
from tests.conftest import TRUTH, implicit_string, waving_pose

T = np.arange(0, 0.6, 0.005)
HAND = resample_hand_motion(T, waving_pose(T, 0.2, -1.0))
DAMPED = TRUTH | {
    "axial_stiffness": 9e5,
    "axial_damping": 1.3e3,
    "bending_damping": 0.67,
    "grasp_stiffness": 3.0,
}


@pytest.mark.parametrize("points", [10, 25, 60])
def test_all_corners_of_table_3_stay_finite(points):
    """All 256 corners, and as many strings within, stay finite.

    The explicit step rejects some as impractical at 60 points. Strings with k_s over
    1e5 stretch to 1.30 lengths at most, as with small explicit steps. Softer strings
    with stiff bending fold their segments, and Eq. 1 itself has no solution then.
    """
    string = implicit_string(points, 5e-4)
    low, high = np.array([[p.low, p.high] for p in string.parameters]).T
    corners = np.where(np.indices((2,) * 8).reshape(8, -1).T, high, low)
    chance = np.random.default_rng(0).random((256, 8)).T
    inside = np.array(
        [p.value(c) for p, c in zip(string.parameters, chance, strict=True)]
    ).T
    values = np.concatenate([corners, inside])
    motion = simulate(string, HAND, values, T)
    assert motion.finite.all()
    stiff_points = motion.points[values[:, 0] > 1e5]
    assert (
        np.linalg.norm(stiff_points - stiff_points[:, :, :1], axis=-1).max()
        < 1.4 * string.length
    )
    _, practical = steps_per_tick(
        replace(string, integrator=SemiImplicitEuler()), string.material(values), 0.005
    )
    assert practical.all() == (points < 60)


def test_strong_damping_at_many_points_is_as_accurate_as_small_steps():
    """A step of half a millisecond is within 0.1 mm of small explicit steps.

    The string has 25 points at the top of c_s and c_h, where the explicit step is 3 us.
    """
    string = implicit_string(25, 5e-4)
    values = string.values(DAMPED)[None]
    exact = replace(string, integrator=RungeKutta4(), largest_step=1e-4)
    difference = (
        simulate(string, HAND, values, T).tip - simulate(exact, HAND, values, T).tip
    )
    assert steps_per_tick(exact, string.material(values), 0.005)[0][0] > 1000
    assert steps_per_tick(string, string.material(values), 0.005)[0][0] == 11
    assert np.linalg.norm(difference, axis=-1).max() < 1e-4


class Stiffening(StringEffect):
    """A cubic spring along the string."""

    name = "stiffening"
    parameters = (Parameter("cube", "m2/s2", "cubic stiffness", 0.0, 1e6, 0.0),)

    @staticmethod
    def tension(stretch: float, cube: float) -> float:
        return cube * stretch**3


@pytest.fixture
def stiffening():
    """Return a string with a cubic spring, and its values."""
    plain = replace(implicit_string(60, 0.005), ranges={})
    stiffening_string = replace(plain, effects=(*PAPER_EFFECTS, Stiffening))
    values = DAMPED | {"quadratic_drag": 1e-4, "stiffening.cube": 1e5}
    return stiffening_string, stiffening_string.values(values)[None]


def test_only_the_nonlinear_part_of_a_law_bounds_the_step(stiffening):
    plain = replace(implicit_string(60, 0.005), ranges={})
    steps, _ = steps_per_tick(
        plain,
        plain.material(plain.values(DAMPED | {"quadratic_drag": 1e-4})[None]),
        0.005,
    )
    assert steps[0] == 1
    stiffening_string, values = stiffening
    steps, _ = steps_per_tick(
        stiffening_string, stiffening_string.material(values), 0.005
    )
    # slope 3 cube stretch^2 at the largest sampled stretch 0.3; dt = 2 / omega, omega^2
    # = 4 slope (1 + 0.2) / l^2
    omega = 2 * np.sqrt(1.2 * 3 * 1e5 * 0.3**2) / stiffening_string.segment_length
    assert steps[0] == pytest.approx(0.005 * omega / 2 / 0.9, rel=0.2)


@pytest.mark.long  # its loop is compiled for 5 s
def test_a_nonlinear_law_stays_finite_at_the_bounded_step(stiffening):
    stiffening_string, values = stiffening
    assert simulate(stiffening_string, HAND, values, T).finite.all()


@pytest.mark.parametrize(
    ("text", "most", "error"),
    [
        (rotation.SMALL_TURN_SOURCE, 26.5, 2e-10),
        (rotation.ANY_TURN_SOURCE, 179.9, 1e-10),
    ],
)
def test_the_turn_of_a_segment_is_the_arc_tangent(text, most, error):
    module = {"njit": numba.njit, "np": np, "LAW": {}}
    exec(text, module)
    for angle in np.radians(np.linspace(-most, most, 1001)):
        assert module["turned"](3 * np.sin(angle), 3 * np.cos(angle)) == pytest.approx(
            angle, rel=error
        )


@pytest.mark.parametrize(
    ("numbers", "limit"),
    [
        (rotation.ATAN_COEFFICIENTS_TO_HALF, 0.5),
        (rotation.ATAN_COEFFICIENTS_TO_ONE, 1.0),
    ],
)
def test_the_constants_of_the_arc_tangent_equal_their_fit(numbers, limit):
    np.testing.assert_allclose(
        numbers, rotation.fit_atan_coefficients(len(numbers), limit), rtol=1e-7
    )


def test_undamped_stiff_modes_do_not_grow():
    """The tip of an undamped stiff string does not accelerate after a single push.

    After 2 s it moves no faster than after 0.5 s.
    """
    string = implicit_string(25, 5e-4)
    t = np.arange(0, 2.5, 0.005)
    push = 0.05 * np.exp(-(((t - 0.1) / 0.03) ** 2))
    hand = resample_hand_motion(t, np.stack([push, 0 * t, 0 * t - np.pi / 2], -1))
    named = {p.name: p.low for p in string.parameters} | {
        "axial_stiffness": 9e5,
        "bending_stiffness": 400.0,
    }
    tip = simulate(string, hand, string.values(named)[None], t).tip[0]
    speed = np.linalg.norm(np.gradient(tip, t, axis=0), axis=-1)
    assert speed[400:].max() < 1.05 * speed[60:160].max()


def test_strong_damping_along_the_string_does_not_ring():
    """After a jerk of the hand, the stretch does not alternate from step to step.

    Damping is ten times the largest of Table 3. With the trapezoidal rule, second
    differences stayed at 1e-3 of the length for 100 steps.
    """
    t = np.arange(0, 0.1, 0.001)
    height = np.clip(0.4 * (t - 0.05), 0.0, None)
    pose = np.stack([0 * t, height, 0 * t - np.pi / 2], axis=-1)[None]
    hand = HandMotion(0.0, 0.001, pose, np.gradient(pose, 0.001, axis=1))
    string = implicit_string(21, 1e-3)
    values = string.values(DAMPED | {"axial_damping": 1e4})[None]
    points = simulate(string, hand, values, t).points[0]
    length = np.linalg.norm(points[:, 1] - points[:, 0], axis=-1)
    stretch = length / string.segment_length
    assert np.abs(np.diff(stretch, 2))[:58].max() > 5e-3  # the jerk
    assert np.abs(np.diff(stretch, 2))[60:].max() < 1e-4


def test_fewer_strips_blow_up_than_by_the_trapezoidal_rule():
    """Strips that hardly damp are thrown upwards by a fast turn of the grasp."""
    rng = np.random.default_rng(0)
    ranges = {
        "axial_stiffness": (9e5, 2.7e7),
        "axial_damping": (1.0, 1e4),
        "bending_stiffness": (20.0, 100.0),
        "bending_damping": (1e-5, 1e-2),
        "linear_drag": (1e-4, 1.0),
        "quadratic_drag": (1e-4, 1.0),
        "grasp_stiffness": (10.0, 1e3),
        "grasp_damping": (1e-4, 0.1),
    }
    string = replace(implicit_string(21, 1e-3), length=0.075)
    values = []
    for _ in range(128):
        chosen = {name: np.exp(rng.uniform(*np.log(r))) for name, r in ranges.items()}
        values.append(string.values(chosen))
    t = np.arange(0, 1.0, 0.005)
    angle = -np.pi / 2 + 1.6 * np.clip(t / 0.02, 0, 1)
    hand = resample_hand_motion(t, np.stack([0 * t, 0 * t, angle], axis=-1))

    def count_torn(integrator):
        motion = simulate(
            replace(string, integrator=integrator), hand, np.array(values), t
        )
        reach = np.linalg.norm(motion.tip, axis=-1).max(axis=1)
        return int((~(reach < 1.5 * string.length)).sum())

    trapezoidal = count_torn(ImplicitLeapfrog(stiffness_weight=0.25))
    assert trapezoidal > 10
    assert count_torn(ImplicitLeapfrog()) < 0.75 * trapezoidal
