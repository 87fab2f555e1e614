"""Initial states of a string, compared with calculations by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.inference import initial_modes, initial_state
from stringcast.stages.inference.initial_state import (
    CURVE_PIECES,
    DIRECTION_WANDERS_RAD,
    HINGE_SHARES,
    RATE_WANDERS_RAD_S,
    Kinematics,
)
from stringcast.stages.inference.prepared_trial import INITIAL_MODES, PreparedTrial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.state import StringState

LENGTH = 0.4
PIECE = LENGTH / CURVE_PIECES
POSE = np.array([0.1, 0.2, 0.3])


def kinematics(s, position, velocity=None, position_sigma=1e-4, velocity_sigma=0.01):
    velocity = np.zeros((len(s), 2)) if velocity is None else velocity
    sigmas = (np.full(len(s), sigma) for sigma in (position_sigma, velocity_sigma))
    return Kinematics(np.asarray(s), np.asarray(position), velocity, *sigmas)


def places_on_curve(s, angle):
    """Compute places on a curve of pieces, which continues straight beyond its end."""
    places = []
    for one in s:
        place = POSE[:2].copy()
        for k in range(CURVE_PIECES):
            left = one - k * PIECE
            inside = left if k == CURVE_PIECES - 1 else min(left, PIECE)
            place += max(inside, 0.0) * np.array([np.cos(angle[k]), np.sin(angle[k])])
        places.append(place)
    return np.array(places)


def test_places_move_with_the_angles_of_the_pieces():
    s = np.array([0.0, 0.004, 0.2, 0.3999, 0.41])
    angle = np.linspace(0.2, 2.0, CURVE_PIECES)
    before = initial_state._length_before(s, LENGTH)
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    assert POSE[:2] + before @ directions == pytest.approx(places_on_curve(s, angle))
    slopes = initial_state._place_slopes(s, angle, LENGTH)
    for k in range(CURVE_PIECES):
        step = 1e-6 * (np.arange(CURVE_PIECES) == k)
        ahead, back = (places_on_curve(s, angle + side * step) for side in (1, -1))
        assert slopes[:, k] == pytest.approx((ahead - back).ravel() / 2e-6, abs=1e-8)
    assert initial_state._piece_middles(LENGTH)[[0, -1]] == pytest.approx(
        [0.5 * PIECE, LENGTH - 0.5 * PIECE]
    )


def test_parabolas_have_the_coefficients_of_least_squares():
    """A place that is seen in three frames has no residual to estimate noise from."""
    t = np.array([0.0, 0.01, 0.02, 0.03])
    tracks = np.random.default_rng(0).standard_normal((4, 2, 2))
    tracks[3, 1] = np.nan
    found, spread, residual_rms = initial_state._fit_parabolas(t, tracks)
    for place, seen in enumerate((4, 3)):
        powers = np.vander(t[:seen], 3, increasing=True)
        track = tracks[:seen, place]
        expected = np.linalg.lstsq(powers, track, rcond=None)[0]
        assert found[place] == pytest.approx(expected)
        covariance = np.linalg.inv(powers.T @ powers)
        assert spread[place] == pytest.approx(np.sqrt(np.diag(covariance)))
        square = np.sum((track - powers @ expected) ** 2)
        assert residual_rms[place] == pytest.approx(np.sqrt(square / 2), abs=1e-9)


def test_the_initial_line_passes_through_measured_places():
    """From the grasp along y, then along x; the angle is continuous from the hand's."""
    s = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    position = POSE[:2] + [[0, 0], [0, 0.1], [0, 0.2], [0.1, 0.2], [0.2, 0.2]]
    pose = np.array([*POSE[:2], 2 * np.pi + 1.0])
    angles = initial_state._straight_line_angles(kinematics(s, position), pose, LENGTH)
    middles = initial_state._piece_middles(LENGTH)
    corners = [0.05, 0.15, 0.25, 0.35]
    turned = 2 * np.pi + np.array([np.pi / 2, np.pi / 2, 0.0, 0.0])
    assert angles == pytest.approx(np.interp(middles, corners, turned))
    # if there are more places, only those nearest to ten corners are used
    s = np.linspace(0.0, 0.4, 81)
    noisy = POSE[:2] + s[:, None] * [0.0, 1.0]
    noisy[1::2] += [0.05, 0.0]
    angles = initial_state._straight_line_angles(kinematics(s, noisy), POSE, LENGTH)
    assert angles == pytest.approx(np.full(CURVE_PIECES, np.pi / 2))


def test_the_shape_is_the_posterior_mean_at_the_wander_of_highest_evidence():
    """If the curve is almost straight, the posterior is that of one linear step."""
    rng = np.random.default_rng(1)
    s = np.linspace(0.04, 0.4, 8)
    angle = POSE[2] + 1.2 * np.sin(np.linspace(0, 3, CURVE_PIECES))
    noise = 1e-4 * rng.standard_normal((8, 2))
    measured = kinematics(s, places_on_curve(s, angle) + noise)
    found = initial_state._fit_shape(measured, POSE, LENGTH)
    slope = initial_state._place_slopes(s, found, LENGTH)
    offset = (measured.position - places_on_curve(s, found)).ravel()
    offset += slope @ (found - POSE[2])
    options = []
    for wander in DIRECTION_WANDERS_RAD:
        for hinge in HINGE_SHARES:
            walk, evidence = initial_state._random_walk_posterior(
                slope, offset, measured.position_sigma, wander, hinge
            )
            options.append((evidence, np.abs(POSE[2] + walk - found).max()))
    assert max(options)[1] < 1e-6
    assert np.abs(found - angle).max() < 0.15


@pytest.mark.parametrize("size", [0.1, 0.5, 1.0, 2.0, 4.0])
def test_a_string_is_taken_to_move_only_with_clear_evidence(size):
    """The evidence must be 20 to 1 against a string that turns with the hand."""
    s = np.linspace(0.05, 0.4, 8)
    angle = np.full(CURVE_PIECES, -np.pi / 2)
    slope = initial_state._place_slopes(s, angle, LENGTH)
    rate = np.array([0.3, -0.2, 1.5])
    turning = size * np.linspace(0.0, 1.0, CURVE_PIECES)
    velocity = rate[:2] + (slope @ (rate[2] + turning)).reshape(-1, 2)
    measured = kinematics(s, np.zeros((8, 2)), velocity, velocity_sigma=0.2)
    found = initial_state._fit_turning_rates(measured, angle, rate, LENGTH)

    def posterior(wander, hinge):
        return initial_state._random_walk_posterior(
            slope, slope @ turning, measured.velocity_sigma, wander, hinge
        )

    at_rest = posterior(0.0, 0.0)[1]
    walks = [posterior(w, h) for w in RATE_WANDERS_RAD_S for h in HINGE_SHARES]
    walk, evidence = max(walks, key=lambda one: one[1])
    gain = evidence - at_rest
    expected = walk if gain > 3.0 else 0.0
    assert found - rate[2] == pytest.approx(expected + np.zeros(CURVE_PIECES))
    assert (gain > 3.0) == (size == 4.0)
    assert gain > -3.0


def test_a_state_at_the_first_frame_has_the_turning_rate_of_the_hand():
    """A straight string turns with its hand, 0.1 s after the motion begins."""
    tick, count = 0.01, 40
    t = tick * np.arange(count)
    rate = np.array([0.2, -0.1, 2.0])
    pose = POSE + t[:, None] * rate
    hand = HandMotion(5.0, tick, pose[None], np.repeat(rate[None, None], count, axis=1))
    at_first = POSE + 0.1 * rate
    s = np.linspace(0.04, 0.4, 10)
    along = np.array([np.cos(at_first[2]), np.sin(at_first[2])])
    across = np.array([-along[1], along[0]])
    measured = kinematics(
        s,
        at_first[:2] + s[:, None] * along,
        rate[:2] + rate[2] * s[:, None] * across,
    )
    times = 5.1 + 0.005 * np.arange(8)
    state = initial_state.estimate_initial_state(hand, LENGTH, times, measured)
    assert state.t == 5.1
    assert state.s == pytest.approx(initial_state._piece_middles(LENGTH))
    assert state.angle == pytest.approx(np.full(CURVE_PIECES, at_first[2]), abs=1e-6)
    assert state.rate == pytest.approx(np.full(CURVE_PIECES, rate[2]))


def test_an_outlying_place_is_left_out_of_the_first_frames():
    """Five times the median residual is an outlier; the others give the noise."""
    t = 0.01 * np.arange(4)
    sizes = np.array([1.0, 1.0, 1.0, 4.9, 5.1])  # of residuals of a parabola
    pattern = np.array([-1.0, 3.0, -3.0, 1.0])[:, None] / np.sqrt(20)
    s = np.linspace(0.1, 0.4, 5)
    points = np.zeros((4, 5, 2))
    points[..., 0] = s + 1e-2 * sizes * pattern * np.sqrt(2)
    frame = np.repeat(np.arange(4), 5)
    found = initial_state.first_frame_kinematics(
        t, frame, np.tile(s, 4), points.reshape(-1, 2), None, LENGTH
    )
    assert list(found.s) == pytest.approx(s[:4])
    noise = 1e-2 * np.sqrt((3 + 4.9**2) / 4)
    powers = np.vander(t, 3, increasing=True)
    deviation = noise * np.sqrt(np.diag(np.linalg.inv(powers.T @ powers)))
    assert found.position_sigma == pytest.approx(np.full(4, deviation[0]))
    assert found.velocity_sigma == pytest.approx(np.full(4, deviation[1]))


def test_a_place_in_a_gap_of_a_frame_is_not_seen_there():
    """In a gap smaller than a twentieth of the length it is interpolated."""
    s = np.array([0.1, 0.2, 0.3, 0.1, 0.219, 0.3, 0.1, 0.221, 0.3])
    frame = np.repeat(np.arange(3), 3)
    points = np.column_stack([s, 2 * s])
    tracks, places = initial_state._early_tracks(frame, s, points, LENGTH)
    assert list(places) == [0.1, 0.2, 0.3]
    assert np.isnan(tracks[:, 1, 0]).tolist() == [False, False, True]
    assert tracks[:2] == pytest.approx(np.repeat([points[:3]], 2, axis=0))


def moving_trial(amplitudes=None, memory=0.2):
    """Return a trial with a known initial state and few other fields."""
    state = StringState(
        1.0, np.array([0.1, 0.3]), np.array([0.5, 0.6]), np.array([2.0, 3.0]), memory
    )
    string = SimpleNamespace(length=LENGTH, memory_count=lambda slot: 1)
    return PreparedTrial(
        "t",
        SimpleNamespace(string=string),
        None,
        np.array([1.0, 1.2, 1.4, 1.6]),
        np.arange(4),
        np.full(4, LENGTH),
        np.arange(8.0).reshape(4, 2),
        np.array([0.1, 0.2, 0.4, 0.5]),
        state,
        mode_amplitudes=np.zeros(12) if amplitudes is None else amplitudes,
    )


def test_amplitudes_of_modes_change_angles_and_rates():
    known = np.linspace(-0.5, 0.5, 12)
    wanted = np.random.default_rng(2).standard_normal((3, 13))
    found = initial_modes.with_initial_amplitudes(moving_trial(known), wanted)
    state = found.initial_state
    for row, amplitudes in enumerate(wanted):
        angle, rate = np.array([0.5, 0.6]), np.array([2.0, 3.0])
        for k in range(INITIAL_MODES):
            wave = np.sin((k + 0.5) * np.pi * np.array([0.1, 0.3]) / LENGTH)
            angle = angle + 0.1 * (amplitudes[k] - known[k]) * wave
            rate = rate + 3.0 * (amplitudes[6 + k] - known[6 + k]) * wave
        assert state.angle[row] == pytest.approx(angle)
        assert state.rate[row] == pytest.approx(rate)
        assert state.memory_reversal[row] == pytest.approx(0.5 * amplitudes[12])
    assert found.mode_amplitudes == pytest.approx(wanted[:, :12])
    alone = initial_modes.with_initial_amplitudes(moving_trial(known), wanted[1])
    assert alone.initial_state.angle == pytest.approx(state.angle[1])
    assert alone.initial_state.memory_reversal == pytest.approx(0.5 * wanted[1, 12])


def test_a_string_with_memory_has_a_parameter_for_its_reversal():
    plain = SimpleNamespace(memory_count=lambda slot: 0)
    one_slot = SimpleNamespace(memory_count=lambda slot: slot == "moment")
    modes = initial_modes.initial_state_parameters(plain)
    assert len(modes) == 12
    assert {(p.low, p.high, p.start) for p in modes} == {(-20.0, 20.0, 0.0)}
    *others, let_back = initial_modes.initial_state_parameters(one_slot)
    assert tuple(others) == modes
    # from 0, a slow pull, to 1, bent far back, in standard deviations
    assert (let_back.low, let_back.high, let_back.start) == (0.0, 2.0, 0.0)


@pytest.fixture
def linear_residuals(monkeypatch):
    """Make the points of a trial linear in its amplitudes."""
    shapes = np.random.default_rng(3).standard_normal((13, 8))

    def residuals(trial, values, amplitudes):
        moved = (amplitudes - values) @ shapes
        return moved[:, : 2 * len(trial.points)] / np.repeat(trial.sigma, 2)

    monkeypatch.setattr(initial_modes, "_residuals_at_amplitudes", residuals)
    return shapes


def test_modes_are_fitted_with_a_unit_prior(linear_residuals):
    """Ridge regression: the prior has one residual for each amplitude."""
    trial = moving_trial(memory=0.0)
    truth = np.full(13, 0.5)
    found = initial_modes.fit_initial_state(
        trial, trial, truth, lambda r: 30 * r, 0.005
    )
    shapes = 30 * linear_residuals / np.repeat(trial.sigma, 2)
    expected = np.linalg.solve(
        shapes @ shapes.T + np.eye(13), shapes @ shapes.T @ truth
    )
    amplitudes = initial_modes.initial_amplitudes(found)
    assert expected[12] > 0  # the reversal of a hinge cannot be negative
    assert amplitudes == pytest.approx(expected, abs=2e-3)


def test_residuals_of_the_initial_state_are_white_or_those_of_divergence(monkeypatch):
    rows = np.array([[1.0, 2.0], [np.nan, 3.0]])
    monkeypatch.setattr(initial_modes, "_residuals_at_amplitudes", lambda *given: rows)
    parameters = initial_modes.MODE_PARAMETERS[:2]
    problem = initial_modes._InitialStateProblem(
        None, None, parameters, lambda residual: 5 * residual, np.inf
    )
    found = problem.residuals(np.array([[0.5, 0.6], [0.25, 1.0]]))
    expected = [[5.0, 10.0, 0.0, 4.0]]
    expected += [[DIVERGED_RESIDUAL, DIVERGED_RESIDUAL, -10.0, 20.0]]
    assert found == pytest.approx(np.array(expected))


def test_a_state_is_refined_with_the_first_part_of_the_trial(monkeypatch):
    """The noise is that of residuals with the present amplitudes."""
    calls = []

    def residuals(trial, values, amplitudes):
        calls.append((len(trial.times), amplitudes))
        return np.array([[2.0, -4.0, 4.0, -4.0]])

    def fit_state(*given):
        calls.append(given)
        return given[0]

    monkeypatch.setattr(initial_modes, "_residuals_at_amplitudes", residuals)
    monkeypatch.setattr(initial_modes, "fit_initial_state", fit_state)
    trial = moving_trial(np.arange(12.0), memory=0.25)
    initial_modes.refine_initial_state(trial, "values", 0.4)
    (frames, amplitudes), fit = calls
    assert frames == 3  # until 0.4 s, included
    assert amplitudes == pytest.approx(np.array([[*range(12), 0.5]]))
    assert fit[0] is trial
    assert len(fit[1].times) == 3
    assert fit[2] == "values"
    assert fit[3](np.ones(1)) == pytest.approx(1 / (1.4826 * 4.0))
    assert fit[4] == initial_modes.STATE_MIN_GAIN
    assert fit[5] == 2.0  # Huber's limit
    initial_modes.refine_initial_state(trial, "values")
    assert calls[2][0] == 3  # half a second

    monkeypatch.setattr(
        initial_modes,
        "_residuals_at_amplitudes",
        lambda *given: np.full((1, 4), np.nan),
    )
    unchanged = initial_modes.refine_initial_state(trial, "values")
    assert np.array_equal(unchanged.mode_amplitudes, trial.mode_amplitudes)
    assert np.array_equal(unchanged.initial_state.angle, trial.initial_state.angle)


def test_mode_columns_are_slopes_of_residuals_and_empty_at_rest(linear_residuals):
    trial = moving_trial(memory=0.0)
    columns = initial_modes.initial_mode_columns(trial, np.zeros(13))
    over_sigma = linear_residuals / np.repeat(trial.sigma, 2)
    assert columns == pytest.approx(over_sigma.T)
    at_rest = SimpleNamespace(initial_state=None, points=np.zeros((4, 2)))
    assert initial_modes.initial_mode_columns(at_rest, None).shape == (8, 0)


def test_a_mode_whose_simulation_diverges_has_zero_slopes(monkeypatch):
    def residuals(trial, values, amplitudes):
        moved = amplitudes @ np.ones((13, 8))
        moved[2, 3] = np.nan
        return moved

    monkeypatch.setattr(initial_modes, "_residuals_at_amplitudes", residuals)
    slopes = initial_modes.initial_mode_columns(moving_trial(memory=0.0), None)
    expected = np.ones((8, 13))
    expected[:, 1] = 0.0
    assert slopes == pytest.approx(expected)


def test_resetting_the_initial_state_displaces_points_by_its_modes():
    amplitudes = np.zeros(12)
    amplitudes[1] = 2.0
    trial = moving_trial(amplitudes, memory=0.25)
    shapes = np.zeros((8, 15))
    shapes[:, 1] = np.arange(8.0)
    shapes[:, 12] = 1.0  # of the reversal, scaled by half
    shapes[:, 13:] = 99.0  # of other causes
    found = initial_modes.reset_initial_state_linear(trial, shapes)
    moved = (2 * np.arange(8.0) + 0.5).reshape(4, 2) * trial.sigma[:, None]
    assert found.points == pytest.approx(trial.points + moved)
