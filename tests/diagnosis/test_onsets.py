"""An unknown disturbance begins in the middle of trials; before it the model holds."""

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import simulate_trial, swing_angles

from stringcast.stages.diagnose.trials import base_model
from stringcast.stages.diagnose.trials.base_model import fit_from_beginnings
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.inference.discrepancy_grid import (
    DISCREPANCY_SCALES_M,
    ONSET_SHARES,
    split_grid_point,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import (
    evaluate_fit,
    fit_hypothesis,
    log_likelihoods,
)
from stringcast.stages.inference.prepared_trial import prepare_trial

PLACES = np.array([8, 14, 20])
SECONDS = 0.6
ONSET_S = 0.35
PUSH_M = 0.08  # of the tip to the side, at the end of a trial
STIFFER = {**TRUTH, "bending_stiffness": 20.0, "linear_drag": 2.0}


def push_string(observed, length):
    """Push the string aside, with a growing displacement after an onset."""
    points = observed.points
    late_s = np.maximum(points["t"] - ONSET_S, 0.0)
    push_m = PUSH_M * late_s / (SECONDS - ONSET_S) * points["s"] / length
    observed.points["x"] = points["x"] + push_m


@pytest.fixture(scope="module")
def fits(arm):
    """Fit the base model to pushed strings, starting from one that is too stiff.

    Returns the data, that fit, and the fit from the beginnings.
    """
    model = with_second_order_mesh(ordinary(arm))
    rng = np.random.default_rng(0)
    trials = []
    for k, angles in enumerate(swing_angles(arm, 3, SECONDS)):
        observed = simulate_trial(f"t{k}", arm, model, TRUTH, angles, PLACES, rng)
        push_string(observed, model.string.length)
        trials.append(prepare_trial(model, observed))
    hypothesis = Hypothesis(model)
    start = model.exponents_of_values(STIFFER)
    data = attach_discrepancy_model(trials, hypothesis, start)
    no_discrepancy = np.zeros(len(trials), dtype=int)
    astray = fit_hypothesis(data, hypothesis, start[None], no_discrepancy)
    return data, astray, fit_from_beginnings(data, astray)


def test_fits_to_the_beginnings_find_the_string(fits):
    """They reach the optimum of a fit from the true string, which others do not."""
    data, astray, fit = fits
    truth = fit.hypothesis.model.exponents_of_values(TRUTH)
    best = fit_hypothesis(data, fit.hypothesis, truth[None], fit.grid_points)
    assert fit.log_evidence == pytest.approx(best.log_evidence, abs=1.0)
    assert astray.log_evidence < best.log_evidence - 50
    for name in ("bending_stiffness", "grasp_stiffness"):
        assert fit.values[name] == pytest.approx(TRUTH[name], rel=0.05)


def test_the_estimated_onset_is_not_after_the_true_one(fits):
    data, _, fit = fits
    true_share = ONSET_S / SECONDS
    for grid_point in fit.grid_points:
        onset, scale_index = split_grid_point(grid_point)
        assert 0 < ONSET_SHARES[onset] <= true_share
        assert DISCREPANCY_SCALES_M[scale_index] > 2e-3


def test_other_strings_are_tried_if_the_fit_is_wrong(fits, monkeypatch):
    """Without steps, the result is another string that fits the beginnings better."""
    data, _, fit = fits
    far = evaluate_fit(data, fit.hypothesis, np.full(len(fit.chi), 0.98))
    monkeypatch.setattr(base_model, "BEGINNING_ITERATIONS", 0)
    monkeypatch.setattr(base_model, "fit_hypothesis", lambda *given: given[2])
    start = fit_from_beginnings(data, far)
    both = np.concatenate([start, far.chi[None]])
    found, before = log_likelihoods(data, fit.hypothesis, both).sum(axis=0)
    assert found > before + 100
