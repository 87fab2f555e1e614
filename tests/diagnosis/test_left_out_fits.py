"""Fits without some trials, by Gauss-Newton steps or by refitting."""

from itertools import chain

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import fit_base_model, simulate_trial, swing_angles

from stringcast.stages.diagnose.evidence import left_out_fits
from stringcast.stages.diagnose.evidence.left_out_fits import (
    MAX_GROUPS,
    _GaussNewtonSteps,
    groups_to_leave_out,
)
from stringcast.stages.diagnose.evidence.predictions import predict_left_out_trials
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.inference.laplace import best_exponents
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.solver import MIN_GAIN

PLACES = np.array([8, 14, 20])
OTHER_STRING = {**TRUTH, "bending_stiffness": 20.0, "linear_drag": 2.0}


def fit_trials(arm, strings):
    """Fit the base model to one swing of each string, given by its values."""
    model = with_second_order_mesh(ordinary(arm))
    rng = np.random.default_rng(0)
    trials = []
    for k, angles in enumerate(swing_angles(arm, len(strings), 0.3)):
        observed = simulate_trial(f"t{k}", arm, model, strings[k], angles, PLACES, rng)
        trials.append(prepare_trial(model, observed))
    return fit_base_model(model, trials)


def refit_to_others(data, fit, left_out):
    others = [k for k in range(len(data.trials)) if k != left_out]
    grid_points = fit.grid_points[others]
    chi, _ = best_exponents(
        data.subset(others),
        fit.hypothesis,
        fit.chi[None],
        grid_points,
        width=fit.width,
    )
    return chi


@pytest.mark.parametrize("trials", [1, 3, 8, 9, 25, 50])
def test_each_trial_is_left_out_once_in_at_most_eight_groups(trials):
    """Groups are whole trials, so that the cost grows linearly with their number."""
    groups = groups_to_leave_out(trials)
    assert len(groups) == min(trials, MAX_GROUPS)
    assert sorted(chain(*groups)) == list(range(trials))
    sizes = [len(group) for group in groups]
    assert max(sizes) - min(sizes) <= 1


def half_squares_of_others(data, fit, left_out, chi):
    """Compute the objective of a fit to the other trials at exponents (P,)."""
    others = [k for k in range(len(data.trials)) if k != left_out]
    likelihood = Likelihood(
        data.subset(others),
        fit.hypothesis.model,
        fit.grid_points[others],
        uniform_indices=fit.hypothesis.base_indices,
    )
    return 0.5 * np.sum(likelihood.residuals(chi[None]) ** 2)


def test_steps_find_the_optimum_without_each_trial(arm):
    """Steps with the slopes of all trials reach the optimum of a refit."""
    data, fit = fit_trials(arm, [TRUTH] * 4)
    groups = groups_to_leave_out(4)
    steps = _GaussNewtonSteps(data, fit, groups)
    steps.run()
    assert steps.has_converged.all()
    gains = []
    for number in range(4):
        at_all = half_squares_of_others(data, fit, number, fit.chi)
        stepped = half_squares_of_others(data, fit, number, steps.chi[number])
        refitted = refit_to_others(data, fit, number)
        refitted = half_squares_of_others(data, fit, number, refitted)
        assert stepped < refitted + 2 * MIN_GAIN
        gains.append(at_all - refitted)
    assert max(gains) > 10 * MIN_GAIN  # leaving trials out matters


def test_a_hypothesis_is_refitted_if_steps_do_not_converge(arm, monkeypatch):
    """Without steps, the hypothesis is refitted to the other trials.

    They predict the trial of another string badly.
    """
    monkeypatch.setattr(left_out_fits, "MAX_STEPS", 0)
    data, fit = fit_trials(arm, [TRUTH, TRUTH, OTHER_STRING])
    predictions = predict_left_out_trials(data, fit)
    for number, prediction in enumerate(predictions):
        refitted = refit_to_others(data, fit, number)
        np.testing.assert_array_equal(prediction.chi, refitted)
    rms = [np.sqrt(np.mean(p.residual**2)) for p in predictions]
    assert rms[2] > 2 * min(rms)
