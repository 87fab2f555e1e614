"""Prepared trials and quantities from them, compared with calculations by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import MASKS, READINGS, Observation
from stringcast.data.schema import DataError
from stringcast.stages.inference import batch, mesh, prepared_trial, search, trial_data
from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.discrepancy_grid import log_grid_prior
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh_correction import MeshCorrection
from stringcast.stages.inference.noise import WHITE_NOISE
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.state import StringState
from tests.conftest import implicit_string

UNIT = Parameter("a", "1", "", low=0.0, high=1.0, start=0.0)
LENGTH = 0.3


@pytest.fixture
def model(arm, camera):
    string = implicit_string(8, 1e-3, LENGTH)
    return Model(string, arm, camera)


def lying_trial(**changes):
    """Return a trial of four frames with two points each."""
    points = np.arange(16.0).reshape(8, 2)
    trial = PreparedTrial(
        "t",
        None,
        None,
        np.array([1.0, 1.1, 1.2, 1.3]),
        np.repeat(np.arange(4), 2),
        np.tile([0.1, 0.3], 4),
        points,
        np.linspace(0.1, 0.8, 8),
        error_model="of the whole",
    )
    return replace(trial, **changes)


def test_a_tip_is_all_points_within_a_millimetre_of_the_outermost():
    s = np.array([0.1, 0.2989, 0.2991, 0.3, 0.3])
    trial = lying_trial(s=s, sigma=np.array([9.0, 9.0, 0.5, 2.0, 1.0]))
    assert trial.is_tip.tolist() == [False, False, True, True, True]
    at_tip = np.array([[3.0, 4.0, 0.0, 0.0, 0.0, 0.0], [0.0, 2.0, 1.0, 0.0, 3.0, 0.0]])
    expected = [np.sqrt(0.25 * 25 / 3), np.sqrt((0.25 * 4 + 4 + 9) / 3)]
    assert trial.tip_rms(at_tip) == pytest.approx(expected)
    assert trial.tip_rms(at_tip[0]) == pytest.approx(expected[0])


def test_a_trial_is_cut_after_frames_with_its_error_model():
    for last, frames in ((1.2, 3), (1.199, 2), (5.0, 4)):
        cut = lying_trial().cut_after(last)
        assert cut.times.tolist() == [1.0, 1.1, 1.2, 1.3][:frames]
        assert cut.frame.tolist() == [0, 0, 1, 1, 2, 2, 3, 3][: 2 * frames]
        for name in ("s", "points", "sigma"):
            own, whole = (getattr(trial, name) for trial in (cut, lying_trial()))
            assert own.tolist() == whole[: 2 * frames].tolist()
        assert cut.error_model is UNIT_ERRORS
    assert lying_trial().point_times.tolist() == [
        1.0,
        1.0,
        1.1,
        1.1,
        1.2,
        1.2,
        1.3,
        1.3,
    ]


def test_residuals_are_simulated_minus_measured_over_sigma():
    trial = lying_trial()
    simulated = trial.points + np.array([1.0, 2.0])[:, None, None]
    found = trial.normalised_residuals(simulated)
    sigma = np.repeat(trial.sigma, 2)
    assert found == pytest.approx(np.array([1 / sigma, 2 / sigma]))


def test_points_are_sampled_at_their_frame_and_place(monkeypatch):
    trial = lying_trial(
        model=SimpleNamespace(string=SimpleNamespace(segment_length=0.05))
    )
    calls = []
    monkeypatch.setattr(
        prepared_trial, "interpolate_measurements", lambda *given: calls.append(given)
    )
    trial.sample_at_points("strings")
    strings, frame, position = calls[0]
    assert strings == "strings"
    assert frame is trial.frame
    assert position == pytest.approx(np.tile([2.0, 6.0], 4))


def test_distances_are_of_all_points_and_of_those_nearest_the_tip():
    trial = lying_trial()
    away = np.zeros((8, 2))
    away[0] = 3.0, 4.0
    away[7] = 0.0, 2.0
    assert trial.mean_square_distances(trial.points + away) == (29 / 8, 4 / 4)


def test_residuals_are_weighed_by_the_uncertainty_of_the_points():
    trial = lying_trial()
    sigma = np.full(8, 0.1)
    sigma[0] = 10.0
    trial = replace(trial, sigma=sigma)
    away = np.zeros((8, 2))
    away[0] = 30.0, 40.0
    away[7] = 0.0, 0.2
    assert trial.mean_square_ratio(trial.points + away) == pytest.approx(29 / 16)


def test_candidates_are_simulated_in_chunks_with_their_own_states(monkeypatch):
    monkeypatch.setattr(prepared_trial, "MAX_BATCH_CANDIDATES", 2)
    calls = []

    def simulate(motion, values, times, start, turn):
        calls.append((values.ravel().tolist(), start, turn))
        return len(calls)

    fake = SimpleNamespace(simulate_observation=simulate)
    values = np.arange(5.0)[:, None]
    found = list(lying_trial(model=fake, turn=0.7).simulate(values))
    assert found == [(slice(0, 2), 1), (slice(2, 4), 2), (slice(4, 5), 3)]
    assert calls == [([0, 1], None, 0.7), ([2, 3], None, 0.7), ([4], None, 0.7)]
    states = np.arange(5.0)[:, None]
    state = StringState(1.0, np.array([0.1]), states, 2 * states)
    list(lying_trial(model=fake, initial_state=state).simulate(values))
    assert [start.angle.ravel().tolist() for _, start, _ in calls[3:]] == [
        [0, 1],
        [2, 3],
        [4],
    ]


T = np.arange(0, 0.1, 0.01)


def observe(theta, swing=0.0, noise=1e-3, **more):
    """Observe a straight string at an angle to the hand, with two bad points."""
    places = np.linspace(0.03, LENGTH, 10)
    angle = theta + swing
    line = places[:, None] * [np.cos(angle), np.sin(angle)]
    points = pd.DataFrame({"t": T.repeat(10), "s": np.tile(places, 10), "valid": True})
    points[["x", "y"]] = np.tile(line, (10, 1))
    if noise is not None:
        points["sigma"] = noise
    points.loc[3, "x"] = np.nan
    points.loc[99, "y"] = np.inf
    points = points.sample(frac=1, random_state=0)
    grasp = pd.DataFrame({"t": T, "x": 0.0, "y": 0.0, "theta": theta})
    return Observation(
        "r", points, READINGS.empty(), MASKS.empty(), grasp=grasp, **more
    )


def test_points_are_sorted_and_non_finite_ones_are_left_out(model):
    trial = prepare_trial(model, observe(-np.pi / 2))
    assert len(trial.points) == 98
    assert trial.times == pytest.approx(T)
    assert trial.frame.tolist() == sorted(trial.frame)
    assert np.bincount(trial.frame).tolist() == [9, *[10] * 8, 9]
    assert trial.s[:9] == pytest.approx(0.03 * np.array([1, 2, 3, 5, 6, 7, 8, 9, 10]))
    assert trial.points[:, 1] == pytest.approx(-trial.s)
    assert trial.sigma == pytest.approx(np.full(98, 1e-3))
    assert trial.turn == 0.0
    assert trial.initial_state is None
    unknown = prepare_trial(model, observe(-np.pi / 2, noise=None))
    assert unknown.sigma.tolist() == [1.0] * 98
    nowhere = observe(-np.pi / 2)
    nowhere.points["x"] = np.nan
    with pytest.raises(DataError, match="no valid point"):
        prepare_trial(model, nowhere)


def test_only_a_hand_that_points_up_has_a_turn(model):
    for side in (1, -1):
        up = prepare_trial(model, observe(np.pi / 2, side * 2.0))
        assert up.initial_state is None
        assert up.turn == pytest.approx(side * 2.0, abs=0.05)
        moving = observe(np.pi / 2, side * 2.0, starts_moving=True)
        begun = prepare_trial(model, moving)
        assert begun.turn == pytest.approx(side * 2.0, abs=0.05)
        assert begun.initial_state.angle[-1] == begun.turn + np.pi / 2
        down = prepare_trial(model, observe(-np.pi / 2, side, starts_moving=True))
        assert down.turn == 0.0
    hidden = observe(np.pi / 2, 2.0)
    hidden.points.loc[hidden.points["t"] < 0.035, "valid"] = False
    hidden.points.loc[hidden.points["t"] > 0.055, "valid"] = False
    assert prepare_trial(model, hidden).turn == 0.0


def test_an_initial_state_is_cached_until_its_inputs_change(model):
    def start(noise=1e-3, length=LENGTH, **changes):
        observed = observe(-np.pi / 2, 1.0, noise, starts_moving=True)
        for name, by in changes.items():
            observed.points[name] *= by
        string = replace(model.string, length=length)
        return prepare_trial(replace(model, string=string), observed).initial_state

    first = start()
    assert start() is first
    # only the median standard deviation is used
    assert start(noise=None) is start(noise=None)
    others = [start(2e-3), start(None), start(length=0.31), start(t=1.1), start(s=0.9)]
    others += [start(x=1.1), start(y=1.1)]
    assert len({id(each) for each in (first, *others)}) == 8


def test_the_motion_is_that_of_joints_if_given_else_of_the_grasp():
    grasp = pd.DataFrame({"t": T, "x": T, "y": 2 * T, "theta": 3 * T})
    found = prepared_trial.observed_motion(
        SimpleNamespace(arm=None, grasp=grasp, trial="r")
    )
    assert found.pose[0, 1] == pytest.approx([0.005, 0.01, 0.015])
    with pytest.raises(DataError, match="neither joint angles nor grasp poses"):
        prepared_trial.observed_motion(SimpleNamespace(arm=None, grasp=None, trial="r"))


def swinging(model, seconds, start=None, sway=0.3, turn=0.0):
    """Return a trial with a swaying hand and a given duration [s]."""
    t = np.arange(0, seconds, 0.02)
    pose = np.column_stack([sway * t**2, 0.1 * t, -np.pi / 2 + t])
    count = len(t)
    return PreparedTrial(
        "t",
        model,
        resample_hand_motion(t, pose),
        t + (0.0 if start is None else start.t),
        np.arange(count),
        np.full(count, LENGTH),
        np.zeros((count, 2)),
        np.ones(count),
        start,
        turn,
    )


def state_at(t, candidates=None):
    """Return a state at a time, for one string or for each candidate."""
    angle = np.array([-1.5, -1.2, -0.9])
    if candidates:
        angle = angle + 0.1 * np.arange(candidates)[:, None]
    rate = 2 * angle
    memory = 0.0 if candidates is None else np.zeros(candidates)
    return StringState(t, np.array([0.05, 0.15, 0.25]), angle, rate, memory)


@pytest.mark.parametrize(
    "names", [(), ("time_offset",), ("rolling_shutter", "time_offset", "arm_lag")]
)
def test_trials_in_a_batch_are_simulated_as_alone(model, names, monkeypatch):
    """Hands and films have different lengths and clocks, at rest and in motion."""
    lagging = model.with_effects(*find_effects(list(names)))
    chi = np.random.default_rng(0).uniform(0.3, 0.6, (3, len(lagging.parameters)))
    values = np.stack([p.value(chi[:, i]) for i, p in enumerate(lagging.parameters)], 1)
    trials = [
        swinging(lagging, 0.2),
        swinging(lagging, 0.1, state_at(0.0)),
        swinging(lagging, 0.3, sway=-0.4),
        swinging(lagging, 0.2, state_at(0.0, 3)),
        swinging(lagging, 0.1, state_at(0.04)),
    ]
    sizes = []
    simulate = batch._simulate_batch

    def record(model, members, values):
        sizes.append(len(members))
        return simulate(model, members, values)

    monkeypatch.setattr(batch, "_simulate_batch", record)
    together = simulate_trials(lagging, trials, values)
    assert sorted(sizes) == [1, 2, 2]
    for trial, points in zip(trials, together, strict=True):
        _, alone = next(trial.simulate(values))
        assert np.isfinite(points).all()
        np.testing.assert_allclose(points, alone.points, atol=1e-12)


def test_residuals_do_not_depend_on_chunks(monkeypatch):
    monkeypatch.setattr(batch, "MAX_BATCH_S", 100.0)
    calls = []

    def simulate(model, trials, values):
        calls.append(len(values))
        return [values, 2 * values]

    monkeypatch.setattr(batch, "simulate_trials", simulate)
    trials = [
        SimpleNamespace(
            times=np.array([0.0, t]), s=[], sample_at_points=lambda x: x + 1
        )
        for t in (5.0, 4.0)
    ]
    values = np.arange(45.0)[:, None]
    first, second = batch._simulate_points(None, trials, values)
    assert first == pytest.approx(values + 1)
    assert second == pytest.approx(2 * values + 1)
    assert calls == [20, 20, 5]  # of 5 s each, in 100 s


def test_a_mesh_correction_is_linear_at_its_centre_and_saturates():
    slopes = (np.array([[1.0, 2.0], [10.0, 20.0]]), np.array([[3.0], [30.0]]))
    correction = MeshCorrection(("a", "b"), np.array([0.5, 0.2]), slopes)
    chi = np.array([[9.0, 0.2003, 0.4999], [9.0, 0.9, 0.1]])
    first, second = correction.correction_at(("c", "b", "a"), chi)
    steps = np.array([[-0.0001, 0.0003], [-0.05, 0.05]])
    assert first == pytest.approx(steps @ slopes[0], rel=1e-4)
    assert second == pytest.approx(steps @ slopes[1], rel=1e-4)
    (alone,) = correction.subset([1]).correction_at(("b",), chi[:, 1:2])
    assert alone == pytest.approx(steps[:, 1:] @ slopes[1][1:], rel=1e-4)
    line = 0.2 + np.linspace(-0.1, 0.1, 2001)[:, None]  # far beyond the radius
    (_, change) = correction.correction_at(("b",), line)
    bends = np.diff(change[:, 0], n=2) / 1e-4  # of the slope, 30 at the centre
    assert np.abs(bends).max() < 0.1  # smooth
    moved = correction.centred_at({"b": 0.23, "c": 0.0})
    assert moved.chi.tolist() == [0.5, 0.23]
    assert correction.chi.tolist() == [0.5, 0.2]


def test_residuals_are_corrected_where_they_did_not_diverge(monkeypatch):
    slopes = (np.array([[1000.0, 2000.0]]),)
    correction = MeshCorrection(("a",), np.array([0.5]), slopes)
    simulated = np.array([[1.0, 2.0], [np.nan, 3.0]])
    monkeypatch.setattr(
        trial_data, "normalised_residuals", lambda *given: [simulated.copy()]
    )
    data = TrialData((None,), mesh_correction=correction)
    model = SimpleNamespace(parameters=(UNIT,), names=("a",))
    (found,) = data.residuals(model, np.array([[0.5003], [0.4999]]))
    corrected = np.array([[1.3, 2.6], [DIVERGED_RESIDUAL, 2.8]])
    assert found == pytest.approx(corrected, rel=1e-4)


def test_random_effects_of_active_causes_are_shapes_of_the_nuisance():
    shapes = {
        name: tuple(np.full((4, k + 1), 10.0 * i + k) for k in range(2))
        for i, name in enumerate(("first", "second", "third"))
    }
    error_model = SimpleNamespace(with_nuisance=lambda added: ("extended", added))

    class AnyTrial(PreparedTrial):
        discrepancy = error_model

    trials = tuple(AnyTrial(**vars(lying_trial())) for _ in range(2))
    data = TrialData(trials, shapes, "correction")

    def extend(*names):
        return data.for_hypothesis(SimpleNamespace(cause_names=names))

    assert extend("other") is data
    found = extend("third", "other", "first")
    for k, trial in enumerate(found.trials):
        name, added = trial.error_model
        expected = np.hstack([shapes["third"][k], shapes["first"][k]])
        assert name == "extended"
        assert added.tolist() == expected.tolist()
    assert found.mesh_correction == "correction"
    assert not found.random_effects
    assert extend("third", "first") is found
    assert extend("first") is not found


def test_trials_have_their_own_likelihood_and_nuisance():
    rng = np.random.default_rng(1)
    trials = []
    for frames in (6, 8):
        s = np.linspace(0.05, LENGTH, 7)
        film = SimpleNamespace(
            times=0.02 * np.arange(frames),
            frame=np.repeat(np.arange(frames), 7),
            s=np.tile(s, frames),
            sigma=np.full(7 * frames, 1e-3),
            model=SimpleNamespace(string=SimpleNamespace(length=LENGTH)),
            noise=WHITE_NOISE,
        )
        shapes = rng.standard_normal((14 * frames, 2))
        film.discrepancy = Discrepancy.for_trial(film, np.ones(frames), shapes)
        trials.append(film)
    data = TrialData(tuple(trials))
    residuals = [rng.standard_normal((3, 14 * frames)) for frames in (6, 8)]
    found = data.log_likelihood_by_grid_point(residuals)
    assert found.shape == (2, 3, len(log_grid_prior()))
    single = [rows[0] for rows in residuals]
    grid_points = np.array([4, 9])
    rest = data.without_nuisance(single, grid_points)
    for k, trial in enumerate(trials):
        coefficients = trial.discrepancy.coefficients(residuals[k])
        expected = trial.discrepancy.log_likelihood_by_grid_point(coefficients)
        assert found[k] == pytest.approx(expected)
        explained = trial.discrepancy.nuisance_mean(coefficients[0], grid_points[k])
        assert rest[k] == pytest.approx(single[k] - explained)


def test_the_error_of_a_mesh_is_the_distance_from_a_finer_one(monkeypatch):
    """Errors of three points in two trials: 3, 4 and 12 mm in x, and 5 mm in y."""
    away = {"coarse": 0.0, "fine": 1e-3}
    trials = [
        np.array([[[3.0, 0.0], [4.0, 0.0]]]),
        np.array([[[12.0, 5.0]]]),
    ]
    fine = SimpleNamespace(model="fine", data=SimpleNamespace(trials=trials))
    monkeypatch.setattr(mesh, "likelihood_on_mesh", lambda likelihood, factor: fine)
    monkeypatch.setattr(
        mesh,
        "measured_points",
        lambda model, trials, values: [away[model] * points for points in trials],
    )
    coarse = SimpleNamespace(
        model="coarse", data=SimpleNamespace(trials=trials), parameters=(UNIT,)
    )
    found = mesh.discretisation_error(coarse, np.array([0.5]))
    assert found == pytest.approx(1e-3 * np.sqrt((9 + 16 + 169) / 3))


class Fitted:
    """A likelihood with given residuals, of trials that begin in motion or at rest."""

    def __init__(self, residuals):
        self.residual_rows = residuals
        self.parameters = (UNIT,)
        trials = tuple(lying_trial() for _ in residuals)
        self.data = SimpleNamespace(trials=trials)

    def with_trials(self, trials):
        changed = Fitted(self.residual_rows)
        changed.data = SimpleNamespace(trials=tuple(trials))
        return changed

    def residuals_by_trial(self, chi):
        assert all(trial.error_model is UNIT_ERRORS for trial in self.data.trials)
        return [rows * chi[0, 0] for rows in self.residual_rows]


def test_each_trial_has_the_noise_of_its_own_residual(monkeypatch):
    columns = [np.ones((4, 2)), np.ones((4, 0))]
    left = iter(columns)
    monkeypatch.setattr(
        search, "initial_mode_columns", lambda trial, values: next(left)
    )
    likelihood = Fitted([np.array([[1.0, -3.0, 2.0]]), np.zeros((1, 4))])
    estimated = search.with_estimated_noise(likelihood, np.array([0.5]))
    errors = [trial.error_model for trial in estimated.data.trials]
    assert [each.scale for each in errors] == pytest.approx([1.4826, 1e-9])
    assert all(isinstance(each, IndependentErrors) for each in errors)
    assert all(
        each.nuisance is shapes for each, shapes in zip(errors, columns, strict=True)
    )


def test_states_are_refined_over_a_span_and_the_loss_is_then_robust(monkeypatch):
    calls = []

    def refine(trial, values, span):
        calls.append((values.tolist(), span))
        return "refined"

    monkeypatch.setattr(search, "refine_initial_state", refine)
    monkeypatch.setattr(
        search, "with_estimated_noise", lambda likelihood, chi: likelihood
    )
    data = TrialData(("first", "second"))
    double = Parameter("a", "1", "", low=0.0, high=2.0, start=0.0)
    likelihood = Likelihood(data, SimpleNamespace(parameters=(double,)))
    found = search.with_refined_initial_states(likelihood, np.array([0.3]))
    assert found.data.trials == ("refined", "refined")
    assert found.limit == 2.0
    assert calls == [([0.6], np.inf)] * 2


def test_survivors_of_a_horizon_are_chosen_with_the_noise_of_the_best_start(
    monkeypatch,
):
    monkeypatch.setattr(search, "with_estimated_noise", lambda *given: given)
    chi = np.array([[3.0], [4.0], [5.0]])
    runs = SimpleNamespace(chi=chi, residual="residual", loss="loss")
    calls = []
    monkeypatch.setattr(
        search, "fit_least_squares", lambda *given: calls.append(given) or runs
    )
    monkeypatch.setattr(search, "_survivors", lambda residual, loss: [2, 0])
    starts = np.array([[0.1], [0.2], [0.3]])
    found = search._fit_until_horizon("likelihood", starts, 7)
    assert found.tolist() == [[5.0], [3.0]]
    (noise_at, given, iterations) = calls[0]
    assert noise_at[0] == "likelihood"
    assert noise_at[1].tolist() == [0.1]
    assert given is starts
    assert iterations == 7


def test_misfit_is_the_mean_square_of_residuals_of_each_candidate():
    rows = np.array([[1.0, 3.0], [0.0, 4.0]])
    likelihood = SimpleNamespace(residuals=lambda chi: rows)
    assert search._mean_square(likelihood, None) == pytest.approx([5.0, 8.0])


def test_exponents_are_refined_with_a_small_minimum_gain(monkeypatch):
    calls = []

    def fit(likelihood, starts, max_iterations, min_gain):
        calls.append((likelihood, starts.tolist(), max_iterations, min_gain))
        return SimpleNamespace(chi=starts + 1)

    monkeypatch.setattr(search, "fit_least_squares", fit)
    found = search.refine_exponents("likelihood", np.array([0.1, 0.2]), 7)
    assert found == pytest.approx([1.1, 1.2])
    assert calls == [("likelihood", [[0.1, 0.2]], 7, 0.005)]


def test_refinement_takes_at_most_ten_rounds(monkeypatch):
    spans = []

    def refine(likelihood, chi, span=np.inf):
        spans.append(span)
        return SimpleNamespace(noise_scales=(1.0, 0.9 ** len(spans)))

    monkeypatch.setattr(search, "with_refined_initial_states", refine)
    monkeypatch.setattr(search, "refine_exponents", lambda fitted, chi, count: chi + 1)
    _, chi = search.refine_solution(None, 0)
    assert chi == 10
    assert spans == [0.5, *[np.inf] * 10]
