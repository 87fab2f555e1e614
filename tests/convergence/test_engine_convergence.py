"""Convergence orders in the step and in the number of points."""

from itertools import pairwise

import numpy as np
import pytest

from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.string import String
from tests.conftest import TRUTH, waving_pose

BASE_VALUES = TRUTH | {
    "axial_stiffness": 2e4,
    "axial_damping": 20.0,
    "bending_stiffness": 2.0,
    "bending_damping": 1e-3,
    "linear_drag": 0.5,
}
T = np.arange(0, 0.6, 0.005)
HAND = resample_hand_motion(T, waving_pose(T, 0.1, -1.0))


CLAMPED = BASE_VALUES | {
    "grasp_stiffness": 5e4,
    "grasp_damping": 1e-4,
    "bending_damping": 0.05,
}


def tip(named: dict[str, float] = BASE_VALUES, **settings) -> np.ndarray:
    string = String(0.3, **settings)
    return simulate(string, HAND, string.values(named)[None], T).tip[0]


def order(errors: list[float], factor: float) -> float:
    return float(np.log(errors[0] / errors[-1]) / np.log(factor ** (len(errors) - 1)))


@pytest.mark.parametrize(
    "integrator", [SemiImplicitEuler(), ImplicitLeapfrog(), RungeKutta4()]
)
def test_integrators_converge_with_their_order(integrator):
    """Halving the step divides the error by 2^order.

    Steps are 1/1.2^k ticks.
    """
    exact = tip(integrator=RungeKutta4(), largest_step=4e-6)
    start = {1: 2.4e-5, 2: 5e-4, 4: 3.2e-4}[integrator.order]
    levels = [1.2**-0, 1.2**-4, 1.2**-8]
    errors = [
        np.abs(tip(integrator=integrator, largest_step=start * level) - exact).max()
        for level in levels
    ]
    assert order(errors, 1.2**4) == pytest.approx(integrator.order, abs=0.35)


def differences(**settings) -> list[float]:
    """Return the largest tip distance between n and twice as many segments."""
    tips = [
        tip(points=n, integrator=RungeKutta4(), **settings) for n in (11, 21, 41, 81)
    ]
    return [np.abs(a - b).max() for a, b in pairwise(tips)]


def test_second_order_in_the_number_of_points():
    """The second-order lumping converges to second order in the number of points.

    The paper's equal points are only of first order.
    """
    fine, paper = differences(tip_cell=0.5, grasp_cell=0.5), differences()
    assert order(fine[1:], 2) > 1.7
    assert 0.7 < order(paper[1:], 2) < 1.3
    assert fine[-1] < paper[-1] / 4


def test_a_damped_clamped_string_converges_to_second_order():
    """The half cell next to a clamp has the damping of the string.

    A clamp that does not turn dissipates nothing.
    """
    settings = {
        "tip_cell": 0.5,
        "grasp_cell": 0.5,
        "integrator": ImplicitLeapfrog(),
        "largest_step": 1e-4,
    }
    tips = [tip(CLAMPED, points=n, **settings) for n in (11, 21, 41, 161)]
    errors = [np.sqrt(np.mean((each - tips[-1]) ** 2)) for each in tips[:-1]]
    assert order(errors, 2) == pytest.approx(2, abs=0.3)


def test_damping_of_a_rigid_clamp_has_no_effect():
    settings = {
        "points": 11,
        "tip_cell": 0.5,
        "grasp_cell": 0.5,
        "integrator": ImplicitLeapfrog(),
    }
    weak, strong = (
        tip(CLAMPED | {"grasp_damping": damping}, **settings) for damping in (1e-5, 1.0)
    )
    assert np.abs(weak - strong).max() < 1e-6
