"""Preparation of data: noise, outliers, chaotic trials, and ranges."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import (
    CRITERIA,
    SIGMA,
    simulate_trial,
    swing_angles,
)

from stringcast.stages.diagnose.trials import preparation
from stringcast.stages.diagnose.trials.base_model import (
    MAX_SEARCH_ITERATIONS,
    sample_trials,
    widen_range_if_supported,
    widen_ranges_with_causes,
)
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import (
    exclude_chaotic_trials,
    fit_mesh_correction,
    subtract_discretisation_error,
    with_second_order_mesh,
)
from stringcast.stages.diagnose.trials.noise import (
    _remove_trial_outliers,
    reestimate_noise,
)
from stringcast.stages.diagnose.trials.prepared_data import PreparedData, RefinedFit
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh_correction import MeshCorrection
from stringcast.stages.inference.noise import remove_smooth_motion
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.search import (
    refine_solution,
    screen_candidates,
    search_parameters,
    with_estimated_noise,
)
from stringcast.stages.inference.solver import fit_least_squares
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effects.maxwell_slip import MaxwellSlip

STATED_SIGMA_M = 1e-3
NOISE = SIGMA / STATED_SIGMA_M
S = np.linspace(0.1, 0.3, 5)
T = np.arange(0, 1.5, 0.005)
PLACES = np.array([8, 14, 20])
TOLERANCE_M = 2e-3


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


def make_trial(model, frame, s, points, times=T):
    """Make a trial with points (n, 2) [m]; only their times and places matter."""
    sigma = np.full(len(s), STATED_SIGMA_M)
    return PreparedTrial("t", model, None, times, frame, s, points, sigma)


def simulate_swings(arm, model, strings):
    """Simulate one swing of each string, given by its parameter values."""
    rng = np.random.default_rng(0)
    trials = []
    for k, angles in enumerate(swing_angles(arm, len(strings), 0.3)):
        values = strings[k]
        trial = simulate_trial(f"t{k}", arm, model, values, angles, PLACES, rng)
        trials.append(prepare_trial(model, trial))
    return tuple(trials)


@pytest.fixture(scope="module")
def trials(arm, model):
    return simulate_swings(arm, model, [TRUTH] * 3)


@pytest.mark.parametrize("kind", ["wandering", "dense", "occluded"])
def test_noise_is_separated_from_misfit_at_any_places(model, kind):
    """Noise is separated from misfit for any spacing of points.

    A traced line has irregular points, some closer than a millimetre.
    """
    rng = np.random.default_rng(1)
    grid = np.linspace(0.02, 0.3, 600 if kind == "dense" else 15)
    frame = np.repeat(np.arange(len(T)), len(grid))
    s = np.tile(grid, len(T))
    if kind == "wandering":
        s = s + np.repeat(rng.uniform(-0.01, 0.01, len(T)), len(grid))
    elif kind == "occluded":
        visible = rng.random(len(s)) < 0.5
        frame = frame[visible]
        s = s[visible]
    misfit_m = 3e-3 * np.sin(4 * np.pi * T[frame] + 5 * s) * s / 0.3
    points = misfit_m[:, None] + SIGMA * rng.standard_normal((len(s), 2))
    trial = make_trial(model, frame, s, points)
    _, noise = remove_smooth_motion(trial, points / STATED_SIGMA_M)
    assert noise == pytest.approx(NOISE, rel=0.05)


def test_outliers_are_removed_and_hardly_any_other_point(model):
    """Outliers are removed, and hardly any other point.

    The misfit of the model is much larger. An outlier shifts the smooth motion a little,
    but its neighbours are kept.
    """
    rng = np.random.default_rng(2)
    s = np.tile(S, len(T))
    frame = np.repeat(np.arange(len(T)), len(S))
    misfit_m = 0.05 * np.sin(9 * T[frame]) * s / 0.3
    points = misfit_m[:, None] + SIGMA * rng.standard_normal((len(s), 2))
    outliers = rng.choice(len(s), 8, replace=False)
    points[outliers] += 0.04
    trial = make_trial(model, frame, s, points)
    kept, _, noise = _remove_trial_outliers(trial, points / STATED_SIGMA_M)
    assert len(kept.s) > 0.95 * len(s)
    remaining = {tuple(point) for point in kept.points}
    assert not any(tuple(point) in remaining for point in points[outliers])
    assert noise == pytest.approx(NOISE, rel=0.1)


def test_a_trial_of_scattered_points_is_not_emptied(model):
    """A tracker had lost the tip in all six frames."""
    frame = np.arange(6)
    points = 0.05 * np.random.default_rng(3).standard_normal((6, 2))
    trial = make_trial(model, frame, np.full(6, 0.3), points, times=frame / 30)
    kept, *_ = _remove_trial_outliers(trial, points / STATED_SIGMA_M)
    assert len(kept.s) == 6


@pytest.fixture(scope="module")
def prepared(model, trials):
    hypothesis = Hypothesis(model)
    chi = hypothesis.model.exponents_of_values(TRUTH)
    data = attach_discrepancy_model(trials, hypothesis, chi)
    fit = evaluate_fit(data, hypothesis, chi)
    return PreparedData(data, fit, trials, trials, 0, np.zeros(3))


def test_all_hypotheses_share_the_growth_that_was_computed_first(prepared, trials):
    hypothesis = prepared.base_fit.hypothesis
    softer = np.clip(prepared.base_fit.chi - 0.2, 0.0, 1.0)
    alone = attach_discrepancy_model(trials, hypothesis, softer)
    shared = attach_discrepancy_model(prepared.data.trials, hypothesis, softer)
    for first, trial, other in zip(
        prepared.data.trials, shared.trials, alone.trials, strict=True
    ):
        assert len(trial.growth) == len(trial.times)
        np.testing.assert_array_equal(trial.growth, first.growth)
        assert np.abs(trial.growth / other.growth - 1).max() > 0.01
        assert trial.discrepancy.basis is first.discrepancy.basis
        cut = trial.first_frames(7)
        np.testing.assert_array_equal(cut.growth, trial.growth[:7])


@pytest.mark.parametrize(
    ("uncertainties_mm", "chaotic"),
    [((0.2, 0.4, 0.6), ()), ((0.2, 10.0, 0.6), ("t1",)), ((0.2, 10.0, 10.0), ())],
)
def test_a_chaotic_trial_is_excluded_with_its_part_of_the_fit(
    prepared, uncertainties_mm, chaotic
):
    """Two other trials must remain."""
    uncertainty_m = np.array(uncertainties_mm) / 1e3
    uncertain = replace(prepared, discretisation_uncertainty_m=uncertainty_m)
    kept = exclude_chaotic_trials(uncertain, TOLERANCE_M)
    assert kept.chaotic_trials == chaotic
    assert {t.name for t in kept.data.trials} == {"t0", "t1", "t2"} - {*chaotic}
    assert len(kept.base_fit.residuals) == len(kept.trials) == 3 - len(chaotic)
    resolved = replace(uncertain, keep_if_chaotic=("t0", "t1", "t2"))
    assert exclude_chaotic_trials(resolved, TOLERANCE_M) is resolved


@pytest.mark.parametrize(
    ("at_the_fit_mm", "fitted", "chaotic"),
    [
        ((5.0, 9.0), [("t0", "t1")], ("t2", "t3")),
        ((1.0, 9.0), [("t0", "t1"), ("t0", "t1", "t2")], ("t3",)),
    ],
)
def test_a_chaotic_trial_returns_if_the_fit_to_the_others_resolves_it(
    at_the_fit_mm, fitted, chaotic, model, prepared, monkeypatch
):
    """Chaotic trials are not part of the first fit."""
    names = ("t0", "t1", "t2", "t3")
    trials = tuple(replace(prepared.trials[0], name=name) for name in names)
    data = prepared.data.trials[0]
    before = replace(
        prepared,
        data=TrialData(tuple(replace(data, name=name) for name in names)),
        trials=trials,
        trials_with_outliers=trials,
        discretisation_uncertainty_m=np.array([0.1, 0.2, 8.0, 9.0]) / 1e3,
    )
    calls = []

    def refine(resolved):
        calls.append(tuple(trial.name for trial in resolved.trials))
        few = np.full(len(resolved.trials), 1e-4)
        return replace(resolved, discretisation_uncertainty_m=few)

    def correct(resolved, left_out, fit):
        assert [trial.name for trial in left_out] == ["t2", "t3"]
        return None, np.array(at_the_fit_mm) / 1e3

    monkeypatch.setattr(preparation, "refine_base_model", refine)
    monkeypatch.setattr(preparation, "corrected_data_of", correct)
    after = preparation.fit_base_model_to_resolved_trials(before, TOLERANCE_M)
    assert calls == fitted
    assert after.chaotic_trials == chaotic
    assert len(after.base_fit.residuals) == len(after.trials) == 4 - len(chaotic)


@pytest.mark.parametrize(
    ("restarted", "elsewhere", "kept"), [(20, 18, 18), (20, -3, 0), (2, 18, 0)]
)
def test_a_fit_from_the_beginnings_is_kept_if_it_has_more_evidence(
    prepared, monkeypatch, restarted, elsewhere, kept
):
    """Its gain may be numerical error at the optimum of the other fit."""
    base = replace(prepared.base_fit, log_evidence=0.0)
    before = replace(prepared, base_fit=base)
    refined = {0.0: 0.0, float(restarted): float(elsewhere)}

    def refine(given, fit):
        return RefinedFit(given, replace(fit, log_evidence=refined[fit.log_evidence]))

    def fit_beginnings(data, fit):
        return replace(fit, log_evidence=float(restarted))

    monkeypatch.setattr(preparation, "refine_to_convergence", refine)
    monkeypatch.setattr(preparation, "fit_from_beginnings", fit_beginnings)
    assert preparation.refine_base_model(before).base_fit.log_evidence == kept


def test_a_base_model_is_searched_in_at_most_eight_trials(trials, model):
    """They are spaced evenly, including the first and the last."""
    many = tuple(replace(trials[0], name=str(k)) for k in range(25))
    sample = sample_trials(Likelihood(TrialData(many), model))
    names = [int(trial.name) for trial in sample.data.trials]
    assert len(names) == 8
    assert {0, 24} < {*names}
    assert set(np.diff(names)) <= {3, 4}
    few = Likelihood(TrialData(many[:5]), model)
    assert sample_trials(few).data.trials == few.data.trials


def test_outliers_that_a_better_fit_explains_are_restored(prepared):
    first = prepared.trials[0]
    is_kept = np.arange(len(first.s)) >= 40
    trials = (first.select_points(is_kept), *prepared.trials[1:])
    poorer = replace(prepared, trials=trials)
    assert poorer.outlier_count == 40
    reconsidered = reestimate_noise(poorer, prepared.base_fit)
    assert reconsidered.point_counts == prepared.point_counts


def test_the_effect_of_another_initial_state_is_not_noise(prepared):
    """A wrong initial state displaces points by much more than noise."""
    trials = []
    residuals = []
    given = zip(prepared.data.trials, prepared.base_fit.residuals, strict=True)
    for trial, residual in given:
        time = trial.times[trial.frame]
        vibration = 50 * np.sin(9 * time) + 20 * (-1.0) ** trial.frame
        shape = np.repeat(vibration, 2)[:, None]  # of both coordinates, over sigma
        discrepancy = trial.discrepancy.with_nuisance(shape)
        trials.append(replace(trial, error_model=discrepancy))
        residuals.append(residual + 3 * shape[:, 0])
    displaced = replace(prepared, data=TrialData(tuple(trials)))
    fit = replace(prepared.base_fit, residuals=residuals)

    expected = reestimate_noise(prepared, prepared.base_fit).trials[0].noise
    found = reestimate_noise(displaced, fit).trials[0].noise
    assert found.variance_of_means == pytest.approx(
        expected.variance_of_means, rel=0.05
    )


def test_the_search_is_robust_against_one_trial_of_another_string(arm, model):
    """One trial of another string does not mislead the search.

    Three trials have one string, the fourth one that is four times as stiff.
    """
    stiff = TRUTH | {"bending_stiffness": 4 * TRUTH["bending_stiffness"]}
    data = TrialData(simulate_swings(arm, model, [TRUTH] * 3 + [stiff]))
    likelihood = Likelihood(data, model)
    configured = model.exponents_of_values({})
    rng = np.random.default_rng(3)
    drawn = rng.uniform(size=(64, len(configured)))
    candidates = np.concatenate([configured[None], drawn])
    starts = screen_candidates(likelihood, candidates, 8)
    found = search_parameters(likelihood, starts, MAX_SEARCH_ITERATIONS)
    _, chi = refine_solution(likelihood, found)
    residuals = data.residuals(model, chi[None])
    rms = [np.sqrt(np.mean(residual**2)) for residual in residuals]
    assert max(rms[:3]) < 1.1
    assert rms[3] > 10


def test_a_range_is_widened_only_if_the_data_require_it(model, prepared):
    parameters = {p.name: p for p in model.string.parameters}
    limited = model.with_ranges(replace(parameters["bending_stiffness"], high=2.0))
    ranges = limited.string.ranges
    trials = tuple(replace(trial, model=limited) for trial in prepared.trials)
    likelihood = Likelihood(TrialData(trials), limited)
    bending = limited.names.index("bending_stiffness")

    chi = np.clip(prepared.base_fit.chi, 0.1, 0.9)
    assert widen_range_if_supported(likelihood, chi, bending)[0] is likelihood
    chi[bending] = 1.0
    wider, chi = widen_range_if_supported(likelihood, chi, bending)
    widened = wider.model.string.ranges
    assert widened["bending_stiffness"].high == pytest.approx(60.0)
    changed = {name for name, p in widened.items() if p != ranges.get(name)}
    assert changed == {"bending_stiffness"}
    assert wider.parameters[bending].value(chi[bending]) > 2.0


def test_a_range_is_kept_if_a_wider_one_explains_hardly_more(model, prepared):
    """The best axial damping is at an end of its range, but hardly determined."""
    damping = {p.name: p for p in model.string.parameters}["axial_damping"]
    index = model.names.index(damping.name)
    high = damping.value(prepared.base_fit.chi[index]) / 2
    limited = model.with_ranges(replace(damping, high=high))
    trials = tuple(replace(trial, model=limited) for trial in prepared.trials)
    likelihood = Likelihood(TrialData(trials), limited)
    start = prepared.base_fit.chi.copy()
    start[index] = 1.0
    with_noise = with_estimated_noise(likelihood, start)
    (chi,) = fit_least_squares(with_noise, start[None]).chi
    assert min(chi[index], 1 - chi[index]) < 1e-9
    assert widen_range_if_supported(likelihood, chi, index)[0] is likelihood


def test_a_range_is_too_narrow_if_a_fit_ends_there_and_a_wider_one_explains_more(
    model, prepared
):
    """The bending stiffness is above one range and inside the other."""
    parameters = {p.name: p for p in model.string.parameters}
    stiffness = parameters["bending_stiffness"]
    for high, expected in ((2.0, 60.0), (stiffness.high, None)):
        limited = model.with_ranges(replace(stiffness, high=high))
        base = Hypothesis(limited)
        chi = base.model.exponents_of_values(TRUTH)
        bending = limited.names.index("bending_stiffness")
        chi[bending] = min(chi[bending], 1.0)
        fit = fit_hypothesis(
            prepared.data, base, chi[None], prepared.base_fit.grid_points
        )
        wider = widen_ranges_with_causes(prepared.data, fit, CRITERIA)
        if expected is None:
            assert wider is None
        else:
            assert wider.string.ranges["bending_stiffness"].high == expected


def test_a_range_is_kept_if_only_the_mesh_correction_costs_evidence(model, prepared):
    """A fit in a wider range has no correction; it is compared with a fit without.

    Without the correction, the axial stiffness is slightly inside its range.
    """
    parameters = {p.name: p for p in model.string.parameters}
    base = Hypothesis(model.with_ranges(parameters["axial_stiffness"]))
    chi = base.model.exponents_of_values(TRUTH)
    axial = model.names.index("axial_stiffness")
    chi[axial] = 1.0
    centre = chi.copy()
    centre[axial] = 0.5
    slopes = []
    for trial in prepared.data.trials:
        slope = np.zeros((len(chi), 2 * len(trial.s)))
        slope[axial] = 100.0
        slopes.append(slope)
    correction = MeshCorrection(model.names, centre, tuple(slopes))
    data = replace(prepared.data, mesh_correction=correction)
    uncorrected = replace(data, mesh_correction=None)
    fit = evaluate_fit(data, base, chi)
    assert fit.log_evidence < evaluate_fit(uncorrected, base, chi).log_evidence - 10
    assert widen_ranges_with_causes(data, fit, CRITERIA) is None


def test_the_mesh_correction_predicts_the_error_at_other_parameters(model, trials):
    """The yield curvature of friction changes from 0.02 to 0.03 /m."""
    hypothesis = Hypothesis(model.with_effects(MaxwellSlip))
    truth = TRUTH | {"maxwell_slip.cap": 2e-3, "maxwell_slip.slip": 0.02}
    chi = hypothesis.model.exponents_of_values(truth)
    moved_chi = hypothesis.model.exponents_of_values(
        truth | {"maxwell_slip.slip": 0.03}
    )
    trials = tuple(replace(trial, model=hypothesis.model) for trial in trials)
    data, uncertainty_m = subtract_discretisation_error(trials, hypothesis, chi)
    fit = evaluate_fit(data, hypothesis, chi)
    prepared = PreparedData(data, fit, trials, trials, 0, uncertainty_m)

    def moved_residuals(data):
        residuals = data.residuals(hypothesis.model, moved_chi[None])
        return np.hstack([residual[0] for residual in residuals])

    exact, _ = subtract_discretisation_error(trials, hypothesis, moved_chi)
    exact_residuals = moved_residuals(exact)
    errors = []
    for correction in (None, fit_mesh_correction(prepared, fit)):
        corrected = replace(data, mesh_correction=correction)
        error = moved_residuals(corrected) - exact_residuals
        errors.append(np.sqrt(np.mean(error**2)))
    assert errors[1] < 0.5 * errors[0]
    # in standard deviations, so that the error is large enough
    assert errors[0] > 0.01


@pytest.mark.parametrize(("left_m", "is_kept"), [(9e-4, True), (1.1e-3, False)])
def test_the_configured_mesh_is_kept_only_if_it_fits_within_noise(
    left_m, is_kept, monkeypatch
):
    """By chance a measured strip fitted ten mass points better, within 0.8 mm."""
    trials = (SimpleNamespace(sigma=np.full(4, 1e-3)),) * 2
    hypothesis = SimpleNamespace(model=None, base=None)
    fine = SimpleNamespace(log_evidence=0.0)
    nearer = SimpleNamespace(log_evidence=1e3, hypothesis=hypothesis)
    monkeypatch.setattr(preparation, "_fit_configured_mesh", lambda *given: nearer)
    monkeypatch.setattr(preparation, "with_model", lambda trials, model: trials)
    monkeypatch.setattr(preparation, "correct_data_at", lambda prepared, fit: prepared)
    monkeypatch.setattr(preparation, "refit", lambda data, fit, hypothesis: fit)
    left = np.array([1e-4, left_m])
    monkeypatch.setattr(preparation, "unexplained_tip_rms", lambda data, fit: left)
    data = SimpleNamespace(trials=trials)
    prepared = PreparedData(data, fine, trials, trials, 0, np.zeros(2))
    kept = preparation.keep_configured_mesh_if_supported(prepared, fine, None)
    assert kept.mesh_is_model == is_kept
