"""Marks with wrong arc lengths."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import SIGMA, simulate_trial, swing_angles

from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.inference import mark_places
from stringcast.stages.inference.batch import measured_points
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit
from stringcast.stages.inference.mark_places import PLACE_ERROR_M, mark_place_columns
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.parameter import parameter_values

MIDDLE, TIP = 10, 20  # numbers of mass points


@pytest.fixture(scope="module")
def hypothesis(arm):
    return Hypothesis(with_second_order_mesh(ordinary(arm)))


@pytest.fixture(scope="module")
def true(hypothesis):
    return hypothesis.model.exponents_of_values(TRUTH)


@pytest.fixture(scope="module")
def prepare(arm, hypothesis):
    def prepare(places):
        model = hypothesis.model
        rng = np.random.default_rng(0)
        (angles,) = swing_angles(arm, 1, 0.4)
        trial = simulate_trial("t", arm, model, TRUTH, angles, np.array(places), rng)
        return prepare_trial(model, trial)

    return prepare


def columns_of(trial, hypothesis, chi):
    values = parameter_values(hypothesis.parameters, chi[None])[0]
    (columns,) = mark_place_columns([trial], hypothesis.model, values)
    return columns


def moved_marks(trial, distance_m):
    """Reduce the stated arc length of marks in the middle of the string."""
    is_middle = trial.s < 0.9 * trial.s.max()
    return replace(trial, s=np.where(is_middle, trial.s - distance_m, trial.s))


def test_a_column_is_the_displacement_by_moving_the_mark(prepare, hypothesis, true):
    """A mark in the middle moves by one standard deviation, the tip does not."""
    trial = prepare([MIDDLE, TIP])
    column = columns_of(trial, hypothesis, true)
    assert column.shape == (2 * len(trial.s), 1)
    values = parameter_values(hypothesis.parameters, true[None])
    farther = moved_marks(trial, -PLACE_ERROR_M)
    (here,), (there,) = (
        measured_points(hypothesis.model, [each], values) for each in (trial, farther)
    )
    moved = (there[0] - here[0]) / trial.sigma[:, None]
    np.testing.assert_allclose(column.reshape(-1, 2), moved, atol=0.02)
    assert not moved[trial.is_tip].any()
    assert np.abs(column).max() == pytest.approx(PLACE_ERROR_M / SIGMA, rel=0.05)


@pytest.mark.parametrize(
    ("places", "count"),
    [([TIP], 0), ([5, TIP], 1), ([5, 12, TIP], 2), ([4, 8, 12, 16, TIP], 3)],
)
def test_half_waves_are_as_many_as_marks_between_grasp_and_tip(
    prepare, hypothesis, true, places, count
):
    assert columns_of(prepare(places), hypothesis, true).shape[1] == count


def test_points_at_the_grasp_do_not_move(prepare, hypothesis, true):
    trial = prepare([0, MIDDLE, TIP])
    columns = columns_of(trial, hypothesis, true).reshape(len(trial.s), 2)
    assert (trial.s == 0).any()
    assert not columns[trial.s == 0].any()
    assert columns[(trial.s > 0) & ~trial.is_tip].any()


def test_columns_are_zero_in_a_trial_whose_simulation_diverges(
    prepare, hypothesis, true, monkeypatch
):
    def diverge(model, trials, values):
        shape = (1, len(trial.times), model.string.points, 2)
        return [np.full(shape, np.nan) for _ in trials]

    trial = prepare([MIDDLE, TIP])
    monkeypatch.setattr(mark_places, "simulate_trials", diverge)
    columns = columns_of(trial, hypothesis, true)
    assert columns.shape == (2 * len(trial.s), 1)
    assert not columns.any()


def test_a_wrong_mark_is_recognised_at_a_small_cost_of_evidence(
    prepare, hypothesis, true
):
    """An error of 3 mm is found within 0.5 mm, at a cost of a few in log-likelihood."""
    distance_m = 3e-3
    off = moved_marks(prepare([MIDDLE, TIP]), distance_m)
    data = attach_discrepancy_model([off], hypothesis, true)
    fit = evaluate_fit(data, hypothesis, true)
    explained = (
        fit.residuals[0] - data.without_nuisance(fit.residuals, fit.grid_points)[0]
    )
    (trial,) = data.trials
    found_m = np.linalg.norm(trial.displacements_m(explained), axis=1)
    assert found_m[~trial.is_tip] == pytest.approx(distance_m, abs=5e-4)
    assert found_m[trial.is_tip] == pytest.approx(0.0, abs=1e-4)

    right = attach_discrepancy_model([prepare([MIDDLE, TIP])], hypothesis, true)
    cost = evaluate_fit(right, hypothesis, true).log_likelihood_by_trial
    assert 0 < (cost - fit.log_likelihood_by_trial)[0] < 10
