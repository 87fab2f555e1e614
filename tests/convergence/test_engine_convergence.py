"""Errors shrink as they should, in the step and in the number of points."""

from itertools import pairwise

import numpy as np
import pytest

from stringcast.stages.model.hand import hand_motion_from_grasp
from stringcast.stages.model.implicit import ImplicitLeapfrog
from stringcast.stages.model.integrator import ExplicitEuler, RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.simulate import simulate
from stringcast.stages.model.string import String

NAMED = {
    "axial_stiffness": 2e4,
    "axial_damping": 20.0,
    "bending_stiffness": 2.0,
    "bending_damping": 1e-3,
    "linear_drag": 0.5,
    "quadratic_drag": 0.2,
    "grasp_stiffness": 2.0,
    "grasp_damping": 5e-3,
}
T = np.arange(0, 0.6, 0.005)
POSE = np.stack([0.1 * np.sin(9 * T) ** 2, 0.1 * np.sin(5 * T) ** 2, -1.0 + 1.5 * np.sin(7 * T) ** 2], axis=-1)
HAND = hand_motion_from_grasp(T, POSE)


def tip(**settings) -> np.ndarray:
    string = String(0.3, **settings)
    return simulate(string, HAND, string.values(NAMED)[None], T).tip[0]


def order(errors: list[float], factor: float) -> float:
    return float(np.log(errors[0] / errors[-1]) / np.log(factor ** (len(errors) - 1)))


@pytest.mark.parametrize("integrator", [SemiImplicitEuler(), ExplicitEuler(), ImplicitLeapfrog(), RungeKutta4()])
def test_order_in_the_step(integrator):
    """Steps of 1/1.2^k ticks: each halving divides the error by 2^order."""
    exact = tip(integrator=RungeKutta4(), largest_step=4e-6)
    start = {1: 2.4e-5, 2: 5e-4, 4: 3.2e-4}[integrator.order]
    levels = [1.2**-0, 1.2**-4, 1.2**-8]
    errors = [np.abs(tip(integrator=integrator, largest_step=start * level) - exact).max() for level in levels]
    assert order(errors, 1.2**4) == pytest.approx(integrator.order, abs=0.35)


def differences(**settings) -> list[float]:
    """Largest tip distance between n and twice as many segments."""
    tips = [tip(points=n, integrator=RungeKutta4(), **settings) for n in (11, 21, 41, 81)]
    return [np.abs(a - b).max() for a, b in pairwise(tips)]


def test_second_order_in_the_number_of_points():
    """With the second-order lumping; the paper's equal points are only first order."""
    fine, paper = differences(tip_cell=0.5, grasp_cell=0.5), differences()
    assert order(fine[1:], 2) > 1.7
    assert 0.7 < order(paper[1:], 2) < 1.3
    assert fine[-1] < 0.2 * paper[-1]
