"""The string at rest, against the answers of statics."""

import numpy as np
import pytest

from stringcast.stages.model.effects.contact import Contact
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.statics.equilibrium import hanging_shape
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.conftest import TRUTH

SECOND_ORDER = {"tip_cell": 0.5, "grasp_cell": 0.5}
STIFF = TRUTH | {"axial_stiffness": 9e5, "grasp_stiffness": 5.0}


def at_rest(string: String, named: dict, theta: float):
    values = string.material(string.values(named)[None])
    angles, lengths = hanging_shape(string, values, np.array([[0.0, 0.0, theta]]))
    return angles[0], lengths[0]


def test_a_hanging_string_stretches_by_the_weight_below():
    """A hanging string stretches by the weight below.

    The elongation of the continuum is mu g L^2 / (2 EA).
    """
    string = String(0.3, points=61, **SECOND_ORDER)
    soft = STIFF | {"axial_stiffness": 9e3}
    _, lengths = at_rest(string, soft, -np.pi / 2)
    stiffness = 9e3 * (0.3 / 9) ** 2
    assert lengths.sum() - 0.3 == pytest.approx(
        9.81 * 0.3**2 / (2 * stiffness), rel=1e-3
    )


def test_the_papers_mass_points_carry_the_weight_below_them():
    """The paper's mass points carry what hangs below them.

    In Eq. 1, segment i stretches by g (n - i) / k_s, with all points of the same mass.
    """
    string = String(0.3, points=10)
    _, lengths = at_rest(string, STIFF | {"axial_stiffness": 9e3}, -np.pi / 2)
    below = np.arange(9, 0, -1)
    np.testing.assert_allclose(lengths - 0.3 / 9, 9.81 * below / 9e3, rtol=1e-9)


def test_a_stiff_string_sags_like_a_cantilever():
    """A stiff string sags like a cantilever.

    The small deflection of a clamped rod is mu g L^4 / (8 EI).
    """
    string = String(0.3, points=81, **SECOND_ORDER)
    named = STIFF | {
        "bending_stiffness": 4e4,
        "grasp_stiffness": 1e9,
        "axial_stiffness": 1e9,
    }
    angles, lengths = at_rest(string, named, 0.0)
    sag = -(lengths * np.sin(angles)).sum()
    bending = 4e4 * (0.3 / 9) ** 2
    assert sag == pytest.approx(9.81 * 0.3**4 / (8 * bending), rel=2e-3)


@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_a_string_from_an_upright_hand_hangs_on_the_side_of_its_turn(lean):
    """From an upright hand, a string hangs on the side of its turn.

    It does so on either side, even on the longer way. The mirrored hand has the mirror
    image.
    """
    string = String(0.3, points=31, **SECOND_ORDER)
    named = STIFF | {"bending_stiffness": 30.0}
    values = string.material(string.values(named)[None])
    poses = (np.array([[0.0, 0.0, np.pi / 2 + side * lean]]) for side in (1, -1))
    right, left = (
        hanging_shape(string, values, pose, -2.0 * side)
        for side, pose in zip((1, -1), poses, strict=True)
    )
    np.testing.assert_allclose(right[0] - np.pi / 2, np.pi / 2 - left[0], atol=1e-9)
    assert (right[1] * np.cos(right[0])).sum() > 0.05
    assert right[0][0, -1] < -0.8


@pytest.mark.parametrize("turn", [-8.3, 8.3])
def test_a_limp_string_does_not_wind_around_its_hand(turn):
    string = String(0.3, points=31, **SECOND_ORDER)
    named = STIFF | {"bending_stiffness": 0.05}
    angles, _ = hanging_shape(
        string,
        string.material(string.values(named)[None]),
        np.array([[0.0, 0.0, np.pi / 2]]),
        turn,
    )
    assert angles[0, -1] - np.pi / 2 == pytest.approx(np.sign(turn) * np.pi, abs=0.1)


def test_a_limp_string_hangs_straight_down_at_any_grasp_angle():
    string = String(0.3, points=25)
    limp = STIFF | {"bending_stiffness": 8e-3, "grasp_stiffness": 1e-3}
    for theta in (-3.0, 0.0, 1.2, 1.5, 2.5):
        angles, _ = at_rest(string, limp, theta)
        assert abs(np.sin(angles[-1]) + 1) < 1e-3
        assert abs(angles[-1] - theta) <= np.pi + 1e-6


@pytest.mark.parametrize("integrator", [SemiImplicitEuler(), ImplicitLeapfrog()])
@pytest.mark.parametrize("points", [10, 25, 60])
@pytest.mark.parametrize("theta", [-np.pi / 2, 0.4, 1.5, 3.0])
def test_a_string_in_equilibrium_stays_at_rest(points, theta, integrator):
    """A string in static equilibrium stays at rest.

    Statics and dynamics are separate code, and must have the same forces.
    """
    string = String(0.3, points=points, integrator=integrator)
    t = np.linspace(0, 0.3, 61)
    pose = np.tile([0.1, 0.2, theta], (61, 1))
    moved = simulate(
        string, resample_hand_motion(t, pose), string.values(STIFF)[None], t
    )
    assert np.abs(moved.points[0] - moved.points[0, :1]).max() < 1e-9


FLOOR = {"contact.height": -0.25, "contact.tilt": 0.0}
WALL = {"contact.height": -0.02, "contact.tilt": 1.2}
SLOPE = {"contact.height": -0.1, "contact.tilt": 0.3}


def values_against_plane(plane: dict, hardness: float, bending: float = 4.0) -> dict:
    """Return the values of a string that leaves to the right.

    A plane is in its way.
    """
    return (
        STIFF
        | {
            "bending_stiffness": bending,
            "grasp_stiffness": 2.0,
            "contact.stiffness": hardness,
        }
        | plane
    )


@pytest.mark.parametrize("hardness", [1e4, 1e6, 1e7])
@pytest.mark.parametrize("plane", [FLOOR, WALL, SLOPE], ids=["floor", "wall", "slope"])
@pytest.mark.parametrize("points", [10, 40])
def test_a_string_that_leans_on_a_plane_stays_at_rest(points, plane, hardness):
    """A string that leans on a plane stays at rest.

    A plane as hard as a table yields less than a string stretches. Statics must balance
    it, or the string would fall.
    """
    string = String(
        0.3,
        points=points,
        effects=(*PAPER_EFFECTS, Contact),
        integrator=ImplicitLeapfrog(),
        **SECOND_ORDER,
    )
    t = np.linspace(0, 0.1, 21)
    pose = np.tile([0.0, 0.0, 0.3], (21, 1))
    moved = simulate(
        string,
        resample_hand_motion(t, pose),
        string.values(values_against_plane(plane, hardness))[None],
        t,
    )
    assert np.abs(moved.points[0] - moved.points[0, :1]).max() < 1e-9


def test_hand_and_floor_carry_the_weight_together():
    """Hand and floor carry the weight together.

    A limp string hangs under a hand 0.2 m above the floor. The part on the floor
    presses with its weight, and hardly sinks in.
    """
    string = String(0.3, points=61, effects=(*PAPER_EFFECTS, Contact), **SECOND_ORDER)
    named = values_against_plane(FLOOR | {"contact.height": -0.2}, 1e7, bending=0.05)
    angles, lengths = at_rest(string, named, -np.pi / 2 + 0.1)
    y = np.cumsum(lengths * np.sin(angles))
    assert y.min() == pytest.approx(-0.2, abs=1e-5)
    is_on_floor = y < -0.2 + 1e-6
    assert np.abs(np.sin(angles[is_on_floor][2:])).max() < 1e-3
    assert (-0.2 - y[is_on_floor])[5:-1] == pytest.approx(9.81 / 1e7, rel=0.05)


def test_contact_of_one_candidate_does_not_depend_on_others():
    string = String(0.3, points=25, effects=(*PAPER_EFFECTS, Contact), **SECOND_ORDER)
    values = np.stack(
        [
            string.values(values_against_plane(p, h))
            for p in (FLOOR, WALL, SLOPE)
            for h in (1e5, 8e6)
        ]
    )
    pose = np.array([[0.0, 0.0, 0.3]])
    joint_shapes = hanging_shape(string, string.material(values), pose)
    single_shapes = [
        hanging_shape(string, string.material(row[None]), pose) for row in values
    ]
    for side in (0, 1):
        np.testing.assert_array_equal(
            joint_shapes[side], np.concatenate([one[side] for one in single_shapes])
        )
