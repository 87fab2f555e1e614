"""A stiff rod between jaws that hold it by dry friction.

It hangs freely, and its swing decays evenly.
"""

import numpy as np

from stringcast.stages.model.effects.grasp_play import GraspPlay
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.state import StringState
from stringcast.stages.model.string import PAPER_EFFECTS
from tests.conftest import implicit_string

LENGTH = 0.3
WEIGHT = 9.81 * LENGTH**2 / 2  # [m3/s2] the moment that holds it level
ROD = {
    "axial_stiffness": 9e6,
    "axial_damping": 100.0,
    "bending_stiffness": 4e5,
    "bending_damping": 0.05,
    "grasp_stiffness": 1e-12,
    # absent by their values, so that no loop without them is compiled
    "grasp_damping": 0.0,
    "linear_drag": 0.0,
    "quadratic_drag": 0.0,
}
HELD_ROD = implicit_string(8, 5e-4, LENGTH, effects=(*PAPER_EFFECTS, GraspPlay))


def resting_hand(theta):
    """Return a hand that rests in this direction for 3 s, and its times."""
    t = np.arange(0, 3.0, 0.005)
    return resample_hand_motion(t, np.stack([0 * t, 0 * t, 0 * t + theta], axis=-1)), t


def test_a_rod_at_rest_hangs_without_friction():
    """The rod hangs at rest as without friction.

    This holds for any direction of the jaws, and the rod stays there.
    """
    values = HELD_ROD.values(ROD | {"grasp_play.cap": 0.2, "grasp_play.slip": 0.02})[
        None
    ]
    tip = simulate(HELD_ROD, resting_hand(-1.0)[0], values, np.linspace(0, 1, 20)).tip[
        0
    ]
    np.testing.assert_allclose(tip, np.tile([0.0, -LENGTH], (20, 1)), atol=1e-4)


def test_dry_friction_reduces_each_swing_by_the_same_amount():
    """The rod's swing falls by the same amount each time.

    W (cos b - cos a) = cap (a + b - 2 slip) from one end a to the next, b. That is
    nearly a straight line.
    """
    cap, slip, start = 0.02 * WEIGHT, 1e-3, 0.35
    hand, t = resting_hand(-np.pi / 2)
    initial = StringState(
        0.0, np.array([0.0, LENGTH]), np.full(2, start - np.pi / 2), np.zeros(2)
    )
    values = HELD_ROD.values(ROD | {"grasp_play.cap": cap, "grasp_play.slip": slip})[
        None
    ]
    tip = simulate(HELD_ROD, hand, values, t, initial).tip[0]
    angle = np.abs(np.arctan2(tip[:, 0], -tip[:, 1]))
    ends = angle[1:-1][(angle[1:-1] >= angle[:-2]) & (angle[1:-1] > angle[2:])]
    expected = [start]
    while len(expected) <= len(ends):
        a, way = expected[-1], np.linspace(0, expected[-1], 100_001)
        left = WEIGHT * (np.cos(way) - np.cos(a)) - cap * (a + way - 2 * slip)
        expected.append(way[np.flatnonzero(left > 0)[-1]])
    assert len(ends) == 6
    np.testing.assert_allclose(ends, expected[1:], atol=1e-3)
    np.testing.assert_allclose(-np.diff(ends), 0.04, atol=2e-3)
