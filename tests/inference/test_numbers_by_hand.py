"""Priors, scales, horizons and intervals, compared with calculations by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad

from stringcast.stages.common import mad_sigma
from stringcast.stages.inference import (
    basis,
    discrepancy,
    discrepancy_grid,
    initial_modes,
    laplace,
    likelihood,
    search,
)
from stringcast.stages.inference.covariance import Covariance
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_state import first_frame_kinematics
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.noise import WHITE_NOISE, Noise, remove_smooth_motion
from stringcast.stages.inference.noise_basis import find_noise_basis
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.search import horizons
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.parameter import Parameter, parameter_exponents
from stringcast.stages.model.statics.chain import GRAVITY_M_S2

TipMass, Wind = find_effects(["tip_mass", "wind"])
ONE_SIDED = Parameter("a", "1", "", low=0.0, high=1.0, start=0.0)
TWO_SIDED = Parameter("a", "1", "", low=-1.0, high=1.0, start=0.0)
DOWNWARDS = Parameter("a", "1", "", low=0.0, high=1.0, start=1.0)


@pytest.mark.parametrize(
    ("amplitude", "whole"), [(ONE_SIDED, 1.0), (DOWNWARDS, 1.0), (TWO_SIDED, 0.5)]
)
def test_the_prior_of_a_tip_shift_integrates_to_one_over_both_signs(amplitude, whole):
    def density(tip_shift):
        return laplace.tip_shift_density(np.asarray(tip_shift), amplitude)

    assert quad(density, 0, 1, points=[0.001, 0.01, 0.1])[0] == pytest.approx(whole)
    widths_m = np.array([1e-3, 3e-3, 1e-2, 3e-2])
    at_zero = whole * np.mean(np.sqrt(2 / np.pi) / widths_m)
    assert density(0.0) == pytest.approx(at_zero)


def test_the_prior_of_an_exponent_is_that_of_its_tip_shift():
    found = laplace.log_prior(ONE_SIDED, 0.2, 0.004, 0.5)
    density = laplace.tip_shift_density(np.asarray(0.004), ONE_SIDED)
    assert found == pytest.approx(np.log(density * 0.004 / 0.2))
    # without the cause, the slope is used
    found = laplace.log_prior(ONE_SIDED, 0.0, 0.004, 0.5)
    density = laplace.tip_shift_density(np.asarray(0.0), ONE_SIDED)
    assert found == pytest.approx(np.log(density * 0.5))
    assert laplace.log_prior(ONE_SIDED, 0.5, 9.0, 0.5) == np.log(np.finfo(float).tiny)


@pytest.mark.parametrize(
    ("along_x", "along_y", "relative"),
    [(0.0, 0.0, 1.0), (0.3, 0.0, 1 / 2), (-0.3, 0.3, 1 / 3), (3.0, 0.0, 1 / 101)],
)
def test_a_draught_is_more_common_than_a_wind(along_x, along_y, relative):
    """Half of all draughts are slower than 0.3 m/s, a tenth of the range."""
    hypothesis = SimpleNamespace(
        parameters=Wind.parameters, amplitude_indices=lambda cause: [0, 1]
    )
    chi = parameter_exponents(Wind.parameters, np.array([along_x, along_y]))
    found = laplace.log_size_prior(hypothesis, Wind, chi)
    assert found == pytest.approx(np.log(relative))


def test_slopes_of_a_diverging_simulation_are_zero():
    shapes = np.array([[3.0, -1.0], [0.5, 2.0]])
    chi = np.array([0.9, 0.2])

    def simulate(model, points):
        diverged = np.where(points[:, [1]] > 0.2, DIVERGED_RESIDUAL, points @ shapes)
        return [points @ shapes, diverged]

    data = SimpleNamespace(
        residuals=simulate, whiten=lambda slopes, scales: np.hstack(slopes)
    )
    further = np.array([[0.5, 0.1]])
    width = np.full(2, 1e-4)
    slopes, others = laplace._residual_slopes(data, None, chi, width, further)
    assert slopes[0] == pytest.approx(shapes)
    assert slopes[1] == pytest.approx(np.array([[3.0, -1.0], [0.0, 0.0]]))
    assert others[1] == pytest.approx(further @ shapes)


def test_the_likeliest_discrepancy_follows_smooth_misfit_in_each_trial():
    rng = np.random.default_rng(3)
    trials = []
    residuals = []
    for size in (30.0, -10.0):
        trial = film(20, 12, rng)
        trial.noise, trial.sigma = WHITE_NOISE, np.full(240, 1e-3)
        trial.discrepancy = discrepancy.Discrepancy.for_trial(
            trial, np.ones(20), np.zeros((480, 0))
        )
        trial.is_tip = trial.s > 0.28
        trial.tip_rms = lambda at_tip: np.sqrt(np.mean(at_tip**2, axis=-1))
        trials.append(trial)
        wave = size * np.sin(9 * trial.times[trial.frame]) * trial.s / 0.3
        residuals.append(np.repeat(wave, 2))
    data = TrialData(tuple(trials))
    hypothesis = SimpleNamespace(cause_names=())
    wide = int(np.searchsorted(discrepancy_grid.DISCREPANCY_SCALES_M, 0.1))
    fit = SimpleNamespace(
        hypothesis=hypothesis, residuals=residuals, grid_points=[wide, wide]
    )
    for mean, residual in zip(
        laplace.mean_discrepancy(data, fit), residuals, strict=True
    ):
        assert mean == pytest.approx(residual, abs=0.2)
    sizes = laplace.sample_discrepancy_tip_rms(data, fit, rng)
    assert sizes.shape == (2, laplace.DISCREPANCY_DRAWS)
    expected = data.tip_rms_by_trial(residuals)
    assert sizes.mean(axis=1) == pytest.approx(expected, rel=0.05)
    fit.grid_points = [0, wide]
    assert not laplace.mean_discrepancy(data, fit)[0].any()


def test_the_volume_is_that_of_a_normal_distribution():
    expected = np.log(2 * np.pi) - 0.5 * np.log(4.0 * 9.0)
    assert laplace.log_volume(np.diag([4.0, 9.0])) == pytest.approx(expected)


def test_scales_of_a_discrepancy_are_half_cauchy():
    prior = np.exp(discrepancy_grid.log_scale_prior())
    scales = discrepancy_grid.DISCREPANCY_SCALES_M
    assert prior.sum() == pytest.approx(1.0)
    assert prior[0] == pytest.approx(2 / np.pi * np.arctan(2.5e-5 / 5e-4))
    edge = np.sqrt(scales[-2] * scales[-1])
    assert prior[-1] == pytest.approx(1 - 2 / np.pi * np.arctan(edge / 5e-4))
    edges = np.sqrt(scales[1:-1] * scales[2:])[[0, 1]]
    inside = 2 / np.pi * (np.arctan(edges / 5e-4) @ [-1, 1])
    assert prior[2] == pytest.approx(inside)


def test_the_grid_point_is_integrated_out_and_the_most_probable_one_is_chosen():
    prior = discrepancy_grid.log_grid_prior()
    same = np.full((2, len(prior)), -7.0)
    marginal = discrepancy_grid.marginal_log_likelihood(same)
    assert marginal == pytest.approx([-7.0, -7.0])
    likeliest = int(np.argmax(prior))
    assert list(discrepancy_grid.most_likely_grid_point(same)) == [likeliest, likeliest]
    same[1, 3] += 20.0
    assert list(discrepancy_grid.most_likely_grid_point(same)) == [likeliest, 3]
    assert discrepancy_grid.marginal_log_likelihood(same)[1] == pytest.approx(
        np.logaddexp(-7.0, 13.0 + prior[3]), abs=1e-3
    )


def test_without_a_discrepancy_the_first_course_is_chosen():
    """Rounding makes another course likelier, which has no meaning."""
    courses = discrepancy_grid.COURSE_COUNT
    by_grid_point = np.full((courses, len(discrepancy_grid.log_grid_prior())), -50.0)
    no_discrepancy = by_grid_point.reshape(courses, courses, -1)[:, :, 0]
    no_discrepancy[:] = 1e-12 * np.eye(courses)
    assert not discrepancy_grid.most_likely_grid_point(by_grid_point).any()


def test_trials_without_a_discrepancy_have_no_say_in_its_typical_course():
    scales = len(discrepancy_grid.DISCREPANCY_SCALES_M)
    constant = discrepancy_grid.COURSE_COUNT - 1
    later = np.array([0, 0, 0, 2 * scales + 4, constant * scales + 3])
    typical = discrepancy_grid.typical_grid_point
    assert typical(later[:3]) == 0
    assert typical(later) == 2 * scales  # the median scale is zero
    assert typical(np.array([*later, *later[4:], 7])) == constant * scales + 3
    assert list(discrepancy_grid.count_courses(later)) == [0, 0, 1, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("blocks", "quantile"), [(1, 12.7062), (2, 12.7062), (5, 2.7764)]
)
def test_an_interval_has_students_width(blocks, quantile):
    covariance = Covariance(np.array([[4.0, 3.0], [3.0, 9.0]]), blocks)
    expected = [2 * quantile, 3 * quantile]
    assert covariance.half_width_95 == pytest.approx(expected, rel=1e-4)
    assert covariance.correlation == pytest.approx(np.array([[1, 0.5], [0.5, 1]]))


def test_blocks_of_time_are_counted_through_all_trials():
    trials = [
        SimpleNamespace(point_times=np.array([0.0, 0.049, 0.051, 0.5])),
        SimpleNamespace(point_times=np.array([0.26, 0.24])),
    ]
    blocks = likelihood.time_blocks(trials)
    assert list(blocks) == [0, 0, 0, 0, 1, 1, 2, 2, 4, 4, 3, 3]


def test_undetermined_uniform_parameters_stay_in_the_middle():
    model = SimpleNamespace(parameters=(ONE_SIDED,) * 3)
    data = SimpleNamespace(
        residuals=lambda model, chi: [np.ones((len(chi), 2))],
        whiten_by_trial=lambda residuals, scales: residuals,
    )
    fitted = Likelihood(data, model, uniform_indices=(0, 2))
    residuals = fitted.residuals(np.array([[0.5, 0.9, 1.0]]))
    assert residuals == pytest.approx(np.array([[1, 1, 0.0, np.sqrt(12.0) * 0.5]]))


def moving(onset_s, state=None, turn=0.2, axis=2):
    """Return a trial of a 0.3 m string whose hand turns suddenly, by an angle [rad].

    On axes 0 and 1 it moves by a distance [m] instead.
    """
    pose = np.repeat([[0.5, -0.4, -1.5]], 10, axis=0)
    pose[:, axis] += turn * (np.arange(10) * 0.01 > onset_s)
    hand = SimpleNamespace(pose=pose[None], start=1.0, tick=0.01)
    return SimpleNamespace(
        initial_state=state,
        times=np.array([1.02, 1.03, 1.04]),
        motion=SimpleNamespace(actual_hand_motion=lambda arm, effects: hand),
        model=SimpleNamespace(arm=None, string=SimpleNamespace(length=0.3)),
        cut_after=lambda last: last,
    )


@pytest.mark.parametrize(
    ("trial", "last"),
    [
        (moving(0.045), 1.05 + 0.1),
        (moving(0.045, "known"), 1.02 + 0.1),
        (moving(0.005), 1.01 + 0.1),
        (moving(-1.0), 1.0 + 0.1),
        (moving(0.045, turn=0.012), 1.05 + 0.1),
        (moving(0.045, turn=0.008), 1.0 + 0.1),  # less than a hundredth of its length
        (moving(0.045, turn=-0.0032, axis=0), 1.05 + 0.1),
        (moving(0.045, turn=-0.0028, axis=0), 1.0 + 0.1),
        (moving(0.045, turn=0.0032, axis=1), 1.05 + 0.1),
        (moving(0.045, turn=0.0028, axis=1), 1.0 + 0.1),
    ],
)
def test_trials_are_cut_after_the_motion_onset(monkeypatch, trial, last):
    monkeypatch.setattr(Likelihood, "with_trials", lambda self, trials: trials)
    fitted = Likelihood(SimpleNamespace(trials=[trial]), None)
    assert fitted.cut_after_onset(0.1) == pytest.approx([last])
    assert fitted.cut_after_onset(0.0)[0] >= 1.03  # at least two frames


def test_horizons_grow_up_to_most_of_the_longest_trial():
    def search_of(parameters, seconds, points):
        trial = SimpleNamespace(times=np.linspace(0, seconds, 9), s=np.zeros(points))
        string = SimpleNamespace(length=GRAVITY_M_S2 * 0.04)
        return SimpleNamespace(
            data=SimpleNamespace(trials=[trial]),
            model=SimpleNamespace(string=string),
            parameters=[None] * parameters,
        )

    swing = np.pi / 2.405 * 0.2  # a quarter of its period
    found = horizons(search_of(4, 0.9, 1000))
    assert found == pytest.approx([swing, 1.75 * swing, np.inf])
    # 40 numbers are needed, and there are 100 per second
    assert horizons(search_of(4, 1.0, 50)) == pytest.approx([0.4, 0.7, np.inf])
    assert horizons(search_of(4, 0.0, 50)) == pytest.approx([swing, np.inf])
    assert horizons(search_of(4, swing, 1000)) == pytest.approx([swing, np.inf])


class Mesh:
    """A likelihood on a mesh, represented by its name."""

    def __init__(self, name):
        self.name = name

    def cut_after_onset(self, horizon):
        return self.name, horizon


@pytest.mark.parametrize(
    ("horizons_s", "most", "fitted"),
    [
        (
            [0.1, 0.2, np.inf],
            11,
            [("coarse", 0.1, 5), ("middle", 0.2, 5), ("fine", np.inf, 60)],
        ),
        (
            [0.1, 0.2, 0.3, np.inf],
            11,
            [("coarse", 0.1, 3), ("coarse", 0.2, 3), ("middle", 0.3, 3)]
            + [("fine", np.inf, 60)],
        ),
        ([0.1, np.inf], 11, [("middle", 0.1, 11), ("fine", np.inf, 60)]),
        (
            [0.1, 0.2, np.inf],
            1,
            [("coarse", 0.1, 1), ("middle", 0.2, 1), ("fine", np.inf, 60)],
        ),
        ([np.inf], 11, [("fine", np.inf, 60)]),
    ],
)
def test_iterations_are_divided_among_horizons_before_the_last(
    monkeypatch, horizons_s, most, fitted
):
    ladder = [Mesh(name) for name in ("fine", "middle", "coarse")]
    monkeypatch.setattr(search, "horizons", lambda likelihood: horizons_s)
    monkeypatch.setattr(search, "mesh_ladder", lambda likelihood: ladder)
    calls = []
    monkeypatch.setattr(
        search,
        "_fit_until_horizon",
        lambda early, chi, iterations: calls.append((*early, iterations)) or chi[:1],
    )
    monkeypatch.setattr(
        search,
        "_fit_whole_trials",
        lambda mesh, chi, iterations: (
            calls.append((mesh.name, np.inf, iterations)) or chi[0]
        ),
    )
    progress = []
    starts = np.array([[0.1, 0.2], [0.3, 0.4]])
    found = search.search_parameters(None, starts, most, progress.append)
    assert calls == fitted
    assert list(found) == [0.1, 0.2]
    count = len(horizons_s)
    assert progress == pytest.approx([(k + 1) / count for k in range(count)])


def test_known_parameters_start_only_fits_to_whole_trials(monkeypatch):
    """Fits to the first part of a trial would move them away."""
    monkeypatch.setattr(search, "horizons", lambda likelihood: [0.1, np.inf])
    monkeypatch.setattr(search, "mesh_ladder", lambda likelihood: [Mesh("fine")])
    fitted = []
    monkeypatch.setattr(
        search,
        "_fit_until_horizon",
        lambda early, chi, iterations: fitted.append(chi.tolist()) or chi[-1:],
    )
    monkeypatch.setattr(
        search,
        "_fit_whole_trials",
        lambda mesh, chi, iterations: fitted.append(chi.tolist()) or chi[-1],
    )
    starts, known = np.array([[0.1, 0.2], [0.3, 0.4]]), np.array([0.5, 0.6])
    found = search.search_parameters(None, starts, 5, known=known)
    assert fitted == [[[0.1, 0.2], [0.3, 0.4]], [[0.3, 0.4], [0.5, 0.6]]]
    assert list(found) == [0.5, 0.6]


class TwoSlopes:
    """A gentle slope of the residual from 3 to 2.99, and beyond it one to 0."""

    parameters = (Parameter("a", "1", "", 0.0, 1.0, 0.0),)
    limit = np.inf
    candidates_at_once = 1

    def __init__(self):
        self.evaluated = []

    def residuals(self, chi):
        self.evaluated.append(chi[:, 0].tolist())
        gentle = 2.99 + 0.02 * chi
        steep = 20 * (chi - 0.9)
        residuals = np.where(chi < 0.5, gentle, steep) * np.ones(400)
        residuals[:, 0] = 0.1  # a constant residual
        return residuals


def test_a_start_far_behind_the_best_is_dropped_in_whole_trials(monkeypatch):
    """The best start is far from its optimum at first; its predicted gain is large."""
    monkeypatch.setattr(
        search, "with_estimated_noise", lambda likelihood, chi: likelihood
    )
    slopes = TwoSlopes()
    found = search._fit_whole_trials(slopes, np.array([[0.4], [0.6]]), 20)
    assert found == pytest.approx([0.9])

    evaluated = np.concatenate(slopes.evaluated)
    assert evaluated.min() == 0.0  # the end of the gentle slope ...
    is_difference = (evaluated > 0) & (evaluated < 2e-3)
    assert not is_difference.any()  # ... where it stopped


def test_candidates_are_screened_on_the_coarsest_mesh_at_the_first_horizon(monkeypatch):
    ladder = [Mesh("fine"), Mesh("coarse")]
    monkeypatch.setattr(search, "horizons", lambda likelihood: [0.1, np.inf])
    monkeypatch.setattr(search, "mesh_ladder", lambda likelihood: ladder)
    calls = []
    monkeypatch.setattr(
        search, "_mean_square", lambda early, chi: calls.append(early) or chi[:, 0]
    )
    chi = np.array([[0.3], [0.1], [0.2]])
    assert search.screen_candidates(None, chi, 2).ravel() == pytest.approx([0.1, 0.2])
    assert calls == [("coarse", 0.1)]


def test_the_better_half_of_the_starts_goes_on_from_different_places():
    loss = np.linspace(1.0, 2.0, 20)
    apart = 10.0 * np.arange(20)[:, None] * np.ones(4)
    assert search._survivors(apart, loss) == list(range(10))
    assert search._survivors(apart[:12], loss[:12]) == list(range(8))
    apart[1] = apart[0] + 0.09  # less than a tenth of the residual away from the best
    apart[2] = apart[0] + 0.11
    assert search._survivors(apart, loss) == [0, *range(2, 10)]
    # with a residual of 2, 0.19 is the same place; the opposite sign is another one
    for away, kept in ((0.19, [0]), (0.21, [0, 1]), (-4.0, [0, 1])):
        apart = np.array([2.0, 2.0 + away])[:, None] * np.ones(4)
        assert search._survivors(apart, np.array([4.0, 4.0])) == kept


def test_refinement_stops_if_the_noise_falls_no_further(monkeypatch):
    scales = iter([1.0, 0.9, 0.895, 0.5])

    def refine_states(likelihood, chi, span=np.inf):
        return SimpleNamespace(noise_scales=(next(scales),))

    monkeypatch.setattr(search, "with_refined_initial_states", refine_states)
    monkeypatch.setattr(search, "refine_exponents", lambda fitted, chi, count: chi + 1)
    fitted, chi = search.refine_solution(None, 0)
    assert fitted.noise_scales == (0.895,)
    assert chi == 2


def test_a_round_that_raises_the_noise_is_rejected_except_the_first(monkeypatch):
    def refine(*noise):
        scales = iter(noise)
        monkeypatch.setattr(
            search,
            "with_refined_initial_states",
            lambda *given: SimpleNamespace(noise_scales=(next(scales),)),
        )
        fitted, chi = search.refine_solution(None, 0)
        return fitted.noise_scales[0], chi

    monkeypatch.setattr(search, "refine_exponents", lambda fitted, chi, count: chi + 1)
    assert refine(1.0, 1.1) == (1.1, 1)
    assert refine(1.0, 0.8, 0.9) == (0.8, 1)


def test_slopes_of_the_initial_state_step_away_from_the_bounds(monkeypatch):
    start = np.array([0.4, 0.0, -0.3])
    shapes = np.arange(12.0).reshape(3, 4)
    calls = []

    def residuals(trial, values, amplitudes):
        calls.append(amplitudes)
        return amplitudes @ shapes

    monkeypatch.setattr(initial_modes, "initial_amplitudes", lambda trial: start)
    monkeypatch.setattr(initial_modes, "_residuals_at_amplitudes", residuals)
    trial = SimpleNamespace(initial_state="known", points=np.zeros((2, 2)))
    columns = initial_modes.initial_mode_columns(trial, None)
    assert columns == pytest.approx(shapes.T)
    assert list(np.sign(np.diag(calls[0][1:] - calls[0][0]))) == [-1, 1, 1]


def film(frames, points, rng):
    """Return a trial of a 0.3 m string, with different places in each frame."""
    return SimpleNamespace(
        times=0.01 * np.arange(frames),
        frame=np.repeat(np.arange(frames), points),
        s=rng.uniform(0.02, 0.3, frames * points),
        model=SimpleNamespace(string=SimpleNamespace(length=0.3)),
    )


def test_noise_is_estimated_after_smooth_motion_is_removed():
    rng = np.random.default_rng(3)
    trial = film(200, 12, rng)
    noise = rng.standard_normal((2400, 2))
    swing = 50 * np.sin(9 * trial.times[trial.frame]) * trial.s / 0.3
    rest, found = remove_smooth_motion(trial, noise + swing[:, None])
    assert found == pytest.approx(1.0, abs=0.03)
    assert np.std(rest) < 0.95  # splines fit some of the noise
    assert np.corrcoef(rest[:, 0], noise[:, 0])[0, 1] > 0.9


def test_nothing_is_removed_if_splines_fit_every_point():
    rng = np.random.default_rng(3)
    trial = film(20, 2, rng)
    residual = rng.standard_normal((40, 2))
    rest, found = remove_smooth_motion(trial, residual)
    assert rest is residual
    assert found == pytest.approx(mad_sigma(residual))


def test_shapes_of_the_nuisance_are_added_and_replaced_in_order():
    rng = np.random.default_rng(3)
    trial = film(20, 12, rng)
    trial.noise, trial.sigma = WHITE_NOISE, np.full(240, 1e-3)
    first, second, third = (rng.standard_normal((480, m)) for m in (2, 3, 1))
    errors = discrepancy.Discrepancy.for_trial(trial, np.ones(20), first)
    errors = errors.with_nuisance(second)
    for shapes in ((first, second), (third, second)):
        together = np.hstack(shapes)
        assert errors.nuisance_shapes == pytest.approx(together)
        expanded = errors.coefficients(together.T).T
        assert errors.nuisance_coefficients == pytest.approx(expanded)
        errors = errors.replace_leading_nuisance(third, 2)


@pytest.mark.parametrize(("sigma", "least"), [(None, 9e-5), (2e-3, 2e-3), (1e-6, 9e-5)])
def test_the_noise_of_a_place_is_at_least_the_stated_one(sigma, least):
    times = 0.01 * np.arange(8)
    places = np.array([0.1, 0.2, 0.3])
    frame, s = np.repeat(np.arange(8), 3), np.tile(places, 8)
    points = np.column_stack([s, 0.5 * s])
    known = first_frame_kinematics(times, frame, s, points, sigma, 0.3)
    exact = first_frame_kinematics(times, frame, s, points, 1.0, 0.3)
    assert known.position_sigma == pytest.approx(least * exact.position_sigma)
    assert known.velocity_sigma == pytest.approx(least * exact.velocity_sigma)
    assert known.position == pytest.approx(points[:3])


@pytest.mark.parametrize(("lost", "seen"), [(1, [0.1, 0.2, 0.3]), (2, [0.1, 0.3])])
def test_a_place_is_used_if_seen_in_three_of_the_first_four_frames(lost, seen):
    times = 0.01 * np.arange(8)
    frame, s = np.repeat(np.arange(8), 3), np.tile([0.1, 0.2, 0.3], 8)
    points = np.column_stack([s, 0.5 * s])
    points[frame >= 4] += 1.0  # later frames are not used
    kept = ~((s == 0.2) & (frame >= 4 - lost) & (frame < 4))
    found = first_frame_kinematics(times, frame[kept], s[kept], points[kept], 1e-3, 0.3)
    assert list(found.s) == seen
    assert found.position == pytest.approx(np.column_stack([seen, 0.5 * found.s]))
    assert found.velocity == pytest.approx(np.zeros((len(seen), 2)), abs=1e-9)


def test_the_noise_of_the_first_frames_is_the_residual_of_parabolas():
    rng = np.random.default_rng(3)
    times = 0.01 * np.arange(8)
    places = np.linspace(0.01, 0.3, 60)
    frame, s = np.repeat(np.arange(8), 60), np.tile(places, 8)
    falling = np.column_stack([s + 0.3 * times[frame], 5.0 * times[frame] ** 2])
    noisy = falling + 1e-3 * rng.standard_normal(falling.shape)
    found = first_frame_kinematics(times, frame, s, noisy, None, 0.3)
    exact = first_frame_kinematics(times, frame, s, falling, 1e-3, 0.3)
    ratio = found.position_sigma.mean() / exact.position_sigma.mean()
    assert ratio == pytest.approx(1.0, abs=0.1)
    assert exact.velocity[:, 0] == pytest.approx(np.full(60, 0.3))
    assert np.std(found.position - exact.position) == pytest.approx(
        exact.position_sigma.mean(), rel=0.2
    )


def test_only_directions_that_points_determine_are_in_a_basis():
    rng = np.random.default_rng(3)
    trial = film(20, 2, rng)
    trial.noise, trial.sigma = WHITE_NOISE, np.ones(40)
    found = find_noise_basis(trial)
    smooth = found.functions
    by_frame = smooth.gram_by_frame(trial.sigma)
    gram = basis.sum_products(smooth.in_time, smooth.in_time, by_frame)
    assert len(found.whiten) == np.linalg.matrix_rank(gram, tol=1e-8 * np.max(gram))
    assert len(found.whiten) < len(gram)
    white = found.whiten @ gram @ found.whiten.T
    assert white == pytest.approx(np.eye(len(white)), abs=1e-4)
    # however large the noise
    for size in (1e-6, 1e6):
        trial.noise = Noise(size * WHITE_NOISE.place_covariance, 0.0)
        assert len(find_noise_basis(trial).whiten) == len(white)


def test_the_last_amplitude_is_the_memory_reversal(monkeypatch):
    count = 2 * initial_modes.INITIAL_MODES
    modes = np.arange(1.0, count + 1)
    trial = SimpleNamespace(
        initial_state=SimpleNamespace(memory_reversal=0.3),
        mode_amplitudes=modes,
        model=SimpleNamespace(string=None),
    )
    for memories in (0, 1):
        monkeypatch.setattr(
            initial_modes,
            "initial_state_parameters",
            lambda string, more=memories: [None] * (count + more),
        )
        expected = [*modes, *[0.3 / initial_modes.LET_BACK_SIGMA] * memories]
        assert initial_modes.initial_amplitudes(trial) == pytest.approx(expected)


def test_whitened_residuals_of_trials_are_concatenated():
    doubled = SimpleNamespace(whiten=lambda residual, scale: scale * residual)
    data = TrialData(tuple(SimpleNamespace(error_model=doubled) for _ in range(2)))
    residuals = [np.array([[1.0, 2.0]]), np.array([[3.0, 4.0, 5.0]])]
    white = data.whiten(residuals, np.array([2, 10]))
    assert white == pytest.approx(np.array([[2.0, 4.0, 30.0, 40.0, 50.0]]))


def test_residuals_are_displacements_in_metres():
    trial = SimpleNamespace(sigma=np.array([0.1, 0.2]))
    found = PreparedTrial.displacements_m(trial, np.array([1.0, 2.0, 3.0, 4.0]))
    assert found == pytest.approx(np.array([[0.1, 0.2], [0.6, 0.8]]))


def test_a_cause_is_added_at_the_end_and_removed_by_itself():
    both = Hypothesis(None).with_cause(TipMass).with_cause(Wind)
    assert both.cause_names == ("tip_mass", "wind")
    assert both.without_cause(TipMass).causes == (Wind,)


def test_the_knot_spacing_leaves_degrees_of_freedom_for_noise():
    assert basis.knot_spacing(np.arange(5) * 0.01) == pytest.approx(0.02)
    assert basis.knot_spacing(np.arange(5) * 0.001) == pytest.approx(0.015)
    assert basis.knot_spacing(np.array([3.0])) == pytest.approx(0.015)
    times = 2.0 + np.arange(11) * 0.01
    assert basis.time_nodes(times, 0.03) == pytest.approx(
        [2.0, 2.025, 2.05, 2.075, 2.1]
    )
    assert len(basis.time_nodes(np.array([0.0, 100.0]), 0.015)) == 64
    assert basis.highest_frequency(np.array([0.0, 0.15])) == pytest.approx(1 / 0.03)


def test_the_overall_tip_rms_averages_squares_over_trials():
    def trial(size):
        return SimpleNamespace(
            is_tip=np.array([False, True]),
            tip_rms=lambda at_tip: size * np.sqrt((at_tip**2).sum(axis=-1)),
        )

    shapes = tuple(np.array([[9.0], [9.0], [3.0], [4.0]]) for _ in range(2))
    data = TrialData((trial(1.0), trial(2.0)), {"wind": shapes})
    assert data.between_trial_tip_rms("wind") == pytest.approx(np.sqrt(62.5))
    assert data.between_trial_tip_rms("tip_mass") == 0.0
    second = data.subset([1])
    assert second.between_trial_tip_rms("wind") == pytest.approx(10.0)
    assert second.mesh_correction is None
