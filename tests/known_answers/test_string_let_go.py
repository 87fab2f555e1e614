"""Strings that start displaced and moving, against mechanics and other motions."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState
from tests.conftest import implicit_string

FINE_STRING = implicit_string(15, 5e-4)
SOFT_VALUES = {
    "axial_stiffness": 9e5,
    "axial_damping": 1300.0,
    "bending_stiffness": 4.0,
    "bending_damping": 0.02,
    "linear_drag": 1.0,
    "grasp_stiffness": 0.05,
}
ROD = {
    "axial_stiffness": 9e5,
    "axial_damping": 100.0,
    "bending_stiffness": 400.0,
    "bending_damping": 0.05,
    "linear_drag": 1e-12,
    "quadratic_drag": 1e-12,
    "grasp_stiffness": 1e-12,
    "grasp_damping": 1e-12,
}
T = np.arange(0, 1.2, 0.005)
HANGING_POSE = np.stack([0 * T, 0 * T, 0 * T - np.pi / 2], axis=-1)
SWINGING_POSE = HANGING_POSE + np.stack(
    [0.1 * np.sin(9 * T), 0.05 * np.cos(7 * T), 0.6 * np.sin(8 * T)], axis=-1
)


def state_of(points, number, tick=T[1]):
    """Return the state at a frame of points (F, n, 2).

    Central differences are of fourth order.
    """
    vector = np.diff(points, axis=1)
    angle = np.unwrap(
        np.unwrap(np.arctan2(vector[..., 1], vector[..., 0]), axis=0), axis=1
    )
    near = angle[number + np.array([-2, -1, 1, 2])]
    rate = np.array([1, -8, 8, -1]) @ near / (12 * tick)
    s = np.linspace(0, 0.3, points.shape[1])
    return StringState(float(number * tick), (s[1:] + s[:-1]) / 2, angle[number], rate)


@pytest.mark.parametrize("speed", [0.0, 0.15])
@pytest.mark.parametrize(
    "integrator", [SemiImplicitEuler(), RungeKutta4(), ImplicitLeapfrog()]
)
def test_a_released_rod_swings_as_a_pendulum(integrator, speed):
    """A released rod swings as a pendulum.

    The angle is a cos(w t) + b / w sin(w t), w^2 = (3 / 2) g / L, as of a thin rod. The
    largest error is 0.7 %, like that of the frequency.
    """
    string = replace(FINE_STRING, points=20, integrator=integrator)
    start = StringState(
        0.0, np.array([0.0, 0.3]), np.full(2, 0.01 - np.pi / 2), np.full(2, speed)
    )
    t = T[:100]
    x = simulate(
        string,
        resample_hand_motion(T, HANGING_POSE),
        string.values(ROD)[None],
        t,
        start,
    ).tip[0, :, 0]
    w = np.sqrt(1.5 * 9.81 / 0.3)
    expected = 0.3 * (0.01 * np.cos(w * t) + speed / w * np.sin(w * t))
    assert np.abs(x - expected).max() < 0.01 * np.abs(expected).max()


@pytest.mark.parametrize(
    "integrator", [SemiImplicitEuler(), RungeKutta4(), ImplicitLeapfrog()]
)
def test_a_motion_continues_from_any_of_its_states(integrator):
    """A motion continues from any of its states.

    The state is midway through a swing at 3 m/s. The error of 0.15 mm is the strain,
    which a state does not contain. With a start at rest it is 363 mm.
    """
    string = replace(FINE_STRING, integrator=integrator)
    hand, values = (
        resample_hand_motion(T, SWINGING_POSE),
        string.values(SOFT_VALUES)[None],
    )
    full_motion = simulate(string, hand, values, T).points[0]
    start = state_of(full_motion, 100)
    rest = simulate(string, hand.starting_at(start.t), values, T[100:], start).points[0]
    assert np.abs(rest - full_motion[100:]).max() < 3e-4


def test_initial_velocities_are_corrected_for_the_lag():
    """Initial velocities are corrected for their lag of half a step.

    Steps of 0.5 and 1 ms are of second order, with errors of 2.8 and 8.6 um; without
    the correction they are 295 and 540 um.
    """
    hand, values = (
        resample_hand_motion(T, HANGING_POSE),
        FINE_STRING.values(SOFT_VALUES)[None],
    )
    start = StringState(
        0.0, np.array([0.0, 0.3]), np.array([-1.5, -0.2]), np.array([0.0, 4.0])
    )
    exact, fine, coarse = (
        simulate(
            replace(FINE_STRING, largest_step=step), hand, values, T[:40], start
        ).tip
        for step in (2.5e-5, 5e-4, 1e-3)
    )
    assert np.abs(fine - exact).max() < 5e-6
    assert np.abs(coarse - exact).max() < 1.5e-5


def test_the_initial_state_is_given_on_the_cameras_clock():
    """The state is given on the camera's clock.

    A camera with a wrong clock films the same release at the same times of its own
    clock, while the hand moves at other times.
    """
    model = Model(FINE_STRING, None, None).with_effects(TimeOffset)
    start = StringState(0.3, np.array([0.0, 0.3]), np.array([-1.5, -0.8]), np.zeros(2))
    values = model.values(SOFT_VALUES)[None].repeat(3, axis=0)
    values[:, -1] = (0.0, 0.02, -0.013)
    t = T[60:160]
    resting_points = model.simulate_observation(
        resample_hand_motion(T, HANGING_POSE), values, t, start
    ).points
    np.testing.assert_allclose(
        resting_points[1:], resting_points[:1].repeat(2, 0), atol=1e-9
    )
    swinging_points = model.simulate_observation(
        resample_hand_motion(T, SWINGING_POSE), values, t, start
    ).points
    np.testing.assert_allclose(
        swinging_points[1, :, 0],
        resample_hand_motion(T, SWINGING_POSE).starting_at(0.32).pose[0, :100, :2],
        atol=1e-9,
    )
    single_points = model.simulate_observation(
        resample_hand_motion(T, SWINGING_POSE), values[1:2], t, start
    ).points[0]
    np.testing.assert_allclose(swinging_points[1], single_points, atol=1e-9)
