"""The string at rest, against the answers of statics."""

import numpy as np
import pytest

from stages.model.equilibrium import hanging
from stages.model.hand import hand_motion_from_grasp
from stages.model.implicit import ImplicitLeapfrog
from stages.model.integrator import SemiImplicitEuler
from stages.model.string import String, simulate

SECOND_ORDER = {"tip_cell": 0.5, "grasp_cell": 0.5}
STIFF = {
    "axial_stiffness": 9e5,
    "axial_damping": 30.0,
    "bending_stiffness": 4.0,
    "bending_damping": 5e-3,
    "linear_drag": 0.3,
    "quadratic_drag": 0.2,
    "grasp_stiffness": 5.0,
    "grasp_damping": 5e-3,
}


def at_rest(string: String, named: dict, theta: float):
    values = string.material(string.values(named)[None])
    angles, lengths = hanging(string, values, np.array([[0.0, 0.0, theta]]))
    return angles[0], lengths[0]


def test_a_hanging_string_stretches_by_the_weight_below():
    """Continuum: elongation = mu g L^2 / (2 EA)."""
    string = String(0.3, points=61, **SECOND_ORDER)
    soft = STIFF | {"axial_stiffness": 9e3}
    _, lengths = at_rest(string, soft, -np.pi / 2)
    stiffness = 9e3 * (0.3 / 9) ** 2
    assert lengths.sum() - 0.3 == pytest.approx(9.81 * 0.3**2 / (2 * stiffness), rel=1e-3)


def test_the_papers_mass_points_carry_what_hangs_below_them():
    """Eq. 1: segment i stretches by g (n - i) / k_s, all points of the same mass."""
    string = String(0.3, points=10)
    _, lengths = at_rest(string, STIFF | {"axial_stiffness": 9e3}, -np.pi / 2)
    below = np.arange(9, 0, -1)
    np.testing.assert_allclose(lengths - 0.3 / 9, 9.81 * below / 9e3, rtol=1e-9)


def test_a_stiff_string_sags_like_a_cantilever():
    """Small deflection of a clamped rod: mu g L^4 / (8 EI)."""
    string = String(0.3, points=81, **SECOND_ORDER)
    named = STIFF | {"bending_stiffness": 4e4, "grasp_stiffness": 1e9, "axial_stiffness": 1e9}
    angles, lengths = at_rest(string, named, 0.0)
    sag = -(lengths * np.sin(angles)).sum()
    bending = 4e4 * (0.3 / 9) ** 2
    assert sag == pytest.approx(9.81 * 0.3**4 / (8 * bending), rel=2e-3)


def test_a_limp_string_hangs_straight_down_whatever_the_grasp():
    string = String(0.3, points=25)
    limp = STIFF | {"bending_stiffness": 8e-3, "grasp_stiffness": 1e-3}
    for theta in (-3.0, 0.0, 1.2, 1.5, 2.5):
        angles, _ = at_rest(string, limp, theta)
        assert abs(np.sin(angles[-1]) + 1) < 1e-3
        assert abs(angles[-1] - theta) <= np.pi + 1e-6


@pytest.mark.parametrize("integrator", [SemiImplicitEuler(), ImplicitLeapfrog()])
@pytest.mark.parametrize("points", [10, 25, 60])
@pytest.mark.parametrize("theta", [-np.pi / 2, 0.4, 1.5, 3.0])
def test_the_engine_leaves_the_equilibrium_alone(points, theta, integrator):
    """Statics and dynamics are written apart: neither may know a force the other does not."""
    string = String(0.3, points=points, integrator=integrator)
    t = np.linspace(0, 0.3, 61)
    pose = np.tile([0.1, 0.2, theta], (61, 1))
    moved = simulate(string, hand_motion_from_grasp(t, pose), string.values(STIFF)[None], t)
    assert np.abs(moved.points[0] - moved.points[0, :1]).max() < 1e-9
