"""A string with a moved beginning equals a string held at that beginning."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from stringcast.stages.model.effects.clamp import Clamp
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.state import StringState
from stringcast.stages.model.string import PAPER_EFFECTS, String

LENGTH = 0.1
STRIP = {
    "axial_stiffness": 9e6,
    "axial_damping": 100.0,
    "bending_stiffness": 30.0,
    "bending_damping": 0.05,
    "linear_drag": 0.3,
    "quadratic_drag": 0.2,
    "grasp_stiffness": 5.0,
    "grasp_damping": 5e-3,
}
T = np.arange(0, 0.3, 0.005)
# active in one test; all tests share two compiled loops
LAWS = find_effects(["density_taper", "rest_curvature", "tip_mass"])
SECOND_ORDER = {
    "tip_cell": 0.5,
    "grasp_cell": 0.5,
    "integrator": ImplicitLeapfrog(),
    "largest_step": 5e-4,
}


def hand(along=0.0, across=0.0):
    """Return a swing of a body, at a place fixed to it, (1, K, 3).

    Poses and rates are from its own motion.
    """
    theta, spin = -1.2 + 0.6 * np.sin(8 * T), 4.8 * np.cos(8 * T)
    arm = np.stack(
        [
            along * np.cos(theta) - across * np.sin(theta),
            along * np.sin(theta) + across * np.cos(theta),
        ]
    )
    x, y = np.stack([0.1 * np.sin(9 * T) ** 2, 0.05 * np.sin(7 * T)]) + arm
    vx, vy = np.stack([0.9 * np.sin(18 * T), 0.35 * np.cos(7 * T)]) + spin * np.stack(
        [-arm[1], arm[0]]
    )
    return HandMotion(
        0.0,
        T[1],
        np.stack([x, y, theta], axis=-1)[None],
        np.stack([vx, vy, spin], axis=-1)[None],
    )


def clamped(points=15):
    return String(LENGTH, points, (*PAPER_EFFECTS, Clamp, *LAWS), **SECOND_ORDER)


def free(length):
    """Make a string that begins where it is stated."""
    return String(length, 15, (*PAPER_EFFECTS, *LAWS), **SECOND_ORDER)


def values(string, **more):
    """Return values of the same material, whatever the string's length."""
    reference = string.length / LENGTH
    return string.values(
        {
            p.name: STRIP[p.name] * reference**-p.length_power
            for p in string.parameters[:8]
        }
        | more
    )


@pytest.mark.parametrize("hidden", [0.012, -0.006])
def test_a_hidden_length_is_a_longer_string_held_further_up(hidden):
    """A hidden length is a longer string held further up, to 1 um at the tip.

    Between points, the string is the curve through the points of the longer one.
    """
    along, across = 0.002, -0.003
    clamp = {"clamp.hidden": hidden, "clamp.along": along, "clamp.across": across}
    string = clamped()
    found = simulate(string, hand(), values(string, **clamp)[None], T).points[0]
    longer = free(LENGTH + hidden)
    real = simulate(
        longer, hand(along - hidden, across), values(longer)[None], T
    ).points[0]
    np.testing.assert_allclose(found[:, -1], real[:, -1], atol=1e-6)
    is_free = string.arc_lengths() + hidden >= 0
    expected = CubicSpline(longer.arc_lengths(), real, axis=1)(
        string.arc_lengths()[is_free] + hidden
    )
    np.testing.assert_allclose(found[:, is_free], expected, atol=2e-5)
    plain = simulate(free(LENGTH), hand(), values(free(LENGTH))[None], T).tip[0]
    assert np.abs(plain - found[:, -1]).max() > 5e-3


def test_a_straight_string_passes_through_the_stated_grasp():
    """A straight string passes through the stated grasp.

    It hangs down from 10 mm above. Points are where they would be without the hidden
    part, but for the stretch.
    """
    string = clamped()
    resting_hand = HandMotion(
        0.0, T[1], np.tile([0.1, 0.2, -np.pi / 2], (1, 60, 1)), np.zeros((1, 60, 3))
    )
    for hidden in (0.01, -0.01):
        found = simulate(
            string, resting_hand, values(string, **{"clamp.hidden": hidden})[None], T
        ).points[0, 0]
        np.testing.assert_allclose(
            found, [[0.1, 0.2 - s] for s in string.arc_lengths()], atol=1e-4
        )  # the stretch is 0.06 mm


def test_a_clamp_does_not_change_other_candidates():
    """A candidate with a clamp does not change other candidates.

    Candidates that are simulated together begin at different places.
    """
    string = clamped()
    candidates = [{}, {"clamp.hidden": 0.01}, {"clamp.across": 0.002}]
    joint_points = simulate(
        string, hand(), np.stack([values(string, **each) for each in candidates]), T
    ).points
    for number, each in enumerate(candidates):
        single_points = simulate(
            string, hand(), values(string, **each)[None], T
        ).points[0]
        np.testing.assert_array_equal(joint_points[number], single_points)


def test_properties_along_the_string_count_from_its_beginning():
    """Properties along the string count from its physical beginning.

    Density that falls to the tip, rest curvature and a hanging weight act as in the
    longer string.
    """
    laws = {
        "density_taper.change": -0.3,
        "rest_curvature.curvature": 3.0,
        "rest_curvature.slope": 2.0,
    }
    laws |= {"tip_mass.ratio": 0.1}
    string, longer = clamped(), free(LENGTH + 0.01)
    found = simulate(
        string, hand(), values(string, **laws, **{"clamp.hidden": 0.01})[None], T
    ).tip[0]
    real = simulate(longer, hand(-0.01), values(longer, **laws)[None], T).tip[0]
    np.testing.assert_allclose(found, real, atol=1e-6)


def test_a_motion_continues_from_a_state_given_from_the_stated_grasp():
    """A motion continues from a state that counts from the stated grasp.

    The string is held firmly, and started from its state after 0.1 s.

    The error of its tip is 0.29 mm, and 64 mm without the hidden part. That part has
    constant curvature between the clamp and the state.
    """
    string = clamped(points=29)
    firm = {"grasp_stiffness": 500.0}
    held = values(string, **firm | {"clamp.hidden": 0.01})[None]
    whole = simulate(string, hand(), held, T).points[0]
    angle = np.unwrap(
        np.unwrap(
            np.arctan2(*np.moveaxis(np.diff(whole, axis=1), -1, 0)[::-1]), axis=0
        ),
        axis=1,
    )
    rate = np.array([1, -8, 8, -1]) @ angle[20 + np.array([-2, -1, 1, 2])] / (12 * T[1])
    start = StringState(float(T[20]), string.segment_middles(), angle[20], rate)
    moved = hand().starting_at(start.t)
    on = simulate(string, moved, held, T[20:], start).tip[0]
    assert np.abs(on - whole[20:, -1]).max() < 4e-4
    without = simulate(string, moved, values(string, **firm)[None], T[20:], start).tip[
        0
    ]
    assert np.abs(without - whole[20:, -1]).max() > 0.05
