"""The engine against Eq. 1 written by hand."""

import numpy as np
import pytest

from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.string import String
from tests.benchmarks.speed.cord import TIMES, hand_motion
from tests.known_answers import equation_1

STRING = String(0.3)
B = {
    "axial_stiffness": 8e5,
    "axial_damping": 30.0,
    "bending_stiffness": 20.0,
    "bending_damping": 1e-2,
}
SOFT_VALUES = {
    "axial_stiffness": 2e4,
    "axial_damping": 5.0,
    "bending_stiffness": 0.3,
    "bending_damping": 1e-3,
}
AIR = {
    "linear_drag": 0.5,
    "quadratic_drag": 0.2,
    "grasp_stiffness": 2.0,
    "grasp_damping": 5e-3,
}
WIDE_RANGES = (
    np.array([p.high for p in STRING.parameters]) ** 0.5
    * np.array([p.low for p in STRING.parameters]) ** 0.5
)


def simulated(values):
    """Return positions at the ticks, (K, n, 2), and the hand at its steps."""
    steps, _ = steps_per_tick(STRING, STRING.material(values[None]), hand_motion().tick)
    points = simulate(STRING, hand_motion(), values[None], TIMES).points[0, :-1]
    assert np.isfinite(points).all()
    return points, equation_1.path(hand_motion(), int(steps[0]))


@pytest.mark.parametrize(
    "values",
    [STRING.values(B | AIR), STRING.values(SOFT_VALUES | AIR), WIDE_RANGES],
    ids=["B", "soft", "wide"],
)
def test_the_engine_equals_equation_1_to_rounding(values):
    """The engine is Equation 1 to rounding.

    At every tick of a trial of 1.5 s the difference is below 9e-13 m as measured.
    """
    engine, path = simulated(values)
    by_hand = equation_1.cast(
        engine[0], values, STRING.segment_length, path, hand_motion().tick
    )
    np.testing.assert_allclose(by_hand, engine, rtol=0, atol=1e-11)
