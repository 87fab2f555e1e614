"""Arc lengths of points on a hanging string, compared with the heavy elastica.

The elastica is solved as a boundary value problem, EI theta'' = lambda g (L - s)
cos(theta), and shares nothing with the rod that is fitted.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, solve_bvp

from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.check.hanging_string import (
    RestingPoints,
    find_resting_points,
    fit_hanging_string,
)

LENGTH_M = 0.32
PLACES_M = np.array([0.1, 0.16, LENGTH_M])  # along the string
NAMES = ("near", "mid", "tip")
HAND_ANGLES = np.radians([-10.0, -25.0, 5.0, -40.0])
GRAVITY_LENGTHS_M = [0.02, 0.06, 0.15]  # (EI / lambda g)^(1/3): limp to stiff


def elastica(theta: float, gravity_length: float, curvature: float = 0.0):
    """Return places of points [m] on a rod clamped at an angle [rad]."""
    s = np.linspace(0.0, LENGTH_M, 400)

    def slope(s, y):
        return np.vstack([y[1], (LENGTH_M - s) * np.cos(y[0]) / gravity_length**3])

    def ends(start, end):
        return np.array([start[0] - theta, end[1] - curvature])

    down = -np.pi / 2 + (theta + np.pi / 2) * np.exp(-s / gravity_length)
    guess = np.vstack([down, np.gradient(down, s)])
    solution = solve_bvp(slope, ends, s, guess, tol=1e-8, max_nodes=100_000)
    assert solution.success
    angle = solution.sol(s)[0]
    x = cumulative_trapezoid(np.cos(angle), s, initial=0.0)
    y = cumulative_trapezoid(np.sin(angle), s, initial=0.0)
    return np.column_stack([np.interp(PLACES_M, s, x), np.interp(PLACES_M, s, y)])


def resting(gravity_length, curvature=0.0, noise_m=0.0):
    """Return the resting points of the elastica in four hands."""
    hands = np.column_stack([np.zeros(4), np.zeros(4), HAND_ANGLES])
    places = [elastica(theta, gravity_length, curvature) for theta in HAND_ANGLES]
    noise = noise_m * np.random.default_rng(0).standard_normal(np.shape(places))
    return RestingPoints(NAMES, hands, places + noise, ("a", "b", "c", "d"))


@pytest.mark.parametrize("length", [LENGTH_M, None])
@pytest.mark.parametrize("gravity_length", GRAVITY_LENGTHS_M)
def test_arc_lengths_of_points_on_a_clamped_rod_are_found(gravity_length, length):
    hanging = fit_hanging_string(resting(gravity_length), length)
    assert [*hanging.arc_lengths] == [*NAMES]
    found = np.array([*hanging.arc_lengths.values()])
    np.testing.assert_allclose(found, PLACES_M, atol=5e-4 if length else 1e-3)
    assert hanging.misfit_m < 5e-4


def test_arc_lengths_on_a_stiff_rod_exceed_distances_from_the_hand():
    """The arc lengths of a limp string would be wrong."""
    chords = resting(GRAVITY_LENGTHS_M[1]).chords
    assert chords[1] < PLACES_M[1] - 0.004
    assert chords[2] < PLACES_M[2] - 0.004


def test_set_and_length_are_distinguished():
    found = fit_hanging_string(resting(0.06, curvature=4.0), None).arc_lengths
    np.testing.assert_allclose([*found.values()], PLACES_M, atol=1.5e-3)


@pytest.mark.parametrize("gravity_length", GRAVITY_LENGTHS_M)
def test_a_wrong_direction_of_the_hand_causes_errors_of_at_most_4_mm(
    gravity_length,
):
    """The hand's direction is wrong by 0.2 rad."""
    turned = resting(gravity_length)
    turned.hands[:, 2] -= 0.2
    found = fit_hanging_string(turned, LENGTH_M).arc_lengths
    np.testing.assert_allclose([*found.values()], PLACES_M, atol=4e-3)


def test_errors_by_noise_are_no_larger_than_the_noise():
    found = fit_hanging_string(resting(0.06, noise_m=5e-4), LENGTH_M).arc_lengths
    np.testing.assert_allclose([*found.values()], PLACES_M, atol=1e-3)


def test_a_limp_string_hangs_straight_for_any_hand_angle():
    hands = np.column_stack([np.zeros(4), np.zeros(4), HAND_ANGLES + 2.0])
    straight = np.column_stack([np.zeros(3), -PLACES_M])
    straight_in_each = np.repeat(straight[None], 4, axis=0)
    limp = RestingPoints(NAMES, hands, straight_in_each, ("a", "b", "c", "d"))
    for length in (LENGTH_M, None):
        found = fit_hanging_string(limp, length).arc_lengths
        np.testing.assert_allclose([*found.values()], PLACES_M, atol=5e-4)


def test_a_stated_length_is_kept_and_other_arc_lengths_are_fitted():
    found = fit_hanging_string(resting(0.06), 0.33).arc_lengths
    assert found["tip"] == pytest.approx(0.33, abs=1e-12)
    assert found["mid"] == pytest.approx(0.16, abs=1e-3)


def test_a_point_at_the_grasp_is_at_the_beginning_of_the_string():
    straight = np.array([[[0.0, 0.0], [0.0, -0.15], [0.0, -0.3]]])
    hand = np.array([[0.0, 0.0, -0.5]])
    at_rest = RestingPoints(("grasp", "mid", "tip"), hand, straight, ("a",))
    for length in (0.3, None):
        found = fit_hanging_string(at_rest, length).arc_lengths
        np.testing.assert_allclose([*found.values()], [0, 0.15, 0.3], atol=1e-3)


def test_no_arc_length_exceeds_that_of_the_end():
    """The mean place of two points at the end is nearer to the hand than the end."""
    places = np.array([[[0.0, -0.3], [0.001, -0.3]], [[0.001, -0.301], [0.0, -0.299]]])
    hands = np.tile([0.0, 0.0, -0.5], (2, 1))
    twice = RestingPoints(("one", "other"), hands, places, ("a", "b"))
    found = fit_hanging_string(twice, 0.3).arc_lengths
    assert found["other"] == pytest.approx(0.3, abs=1e-12)
    assert found["one"] == pytest.approx(0.3, abs=2e-3)
    assert found["one"] <= found["other"]


def recording(name, hand_x, places, starts_moving=False):
    """Return 20 frames of points below a hand that all move after ten frames."""
    t = np.arange(20.0)
    moved = np.where(t > 10, 0.3, 0.0)[:, None] * [1.0, 0.0]
    hand = np.tile([hand_x, 0.0, 1.0], (20, 1))
    tracks = []
    for point, y in places.items():
        tracks.append(Track(point, None, t, np.array([hand_x, y]) + moved))
    return Recording(name, t, None, hand, tuple(tracks), starts_moving)


def test_resting_points_are_collected_from_trials_that_begin_at_rest():
    """The nearest point is first; a string that starts moving has none."""
    both = {"tip": -0.3, "mid": -0.1}
    recordings = [
        recording("a", 0.1, both),
        recording("moving", 0.0, both, starts_moving=True),
        recording("b", 0.2, {"tip": -0.3}),
    ]
    found = find_resting_points(Measurements(tuple(recordings)))
    assert found.names == ("mid", "tip")
    assert found.trials == ("a", "b")
    np.testing.assert_allclose(found.hands, [[0.1, 0, 1], [0.2, 0, 1]])
    np.testing.assert_allclose(found.places[0], [[0, -0.1], [0, -0.3]], atol=1e-12)
    assert np.isnan(found.places[1, 0]).all()
    np.testing.assert_allclose(found.chords, [0.1, 0.3])


def test_a_point_that_moves_in_its_first_frames_does_not_rest():
    """With a slow camera, the tip was at rest in only one frame."""
    still = recording("still", 0.0, {"mid": -0.1, "tip": -0.3})
    *others, tip = recording("slow", 0.0, {"mid": -0.1, "tip": -0.3}).tracks
    moving_tip = replace(tip, xy=tip.xy + 0.01 * tip.t[:, None])
    slow = replace(still, name="slow", tracks=(*others, moving_tip))
    found = find_resting_points(Measurements((still, slow)))
    np.testing.assert_array_equal(np.isfinite(found.places[..., 0]), [[1, 1], [1, 0]])
    assert find_resting_points(Measurements((slow,))) is None


@pytest.mark.parametrize(
    "recordings",
    [
        [],
        [recording("at the grasp", 0.0, {"clamp": 2e-4})],
        [recording("moving", 0.0, {"tip": -0.3}, starts_moving=True)],
    ],
)
def test_no_resting_points_are_found_without_points_at_rest_beyond_the_grasp(
    recordings,
):
    assert find_resting_points(Measurements(tuple(recordings))) is None
