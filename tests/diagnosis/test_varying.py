"""A cause that varies between trials, with a common size and a deviation in each."""

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import simulate_trial, swing_angles

from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.library import effects_by_name

TRIALS = 4
MEAN_CURVATURE = 2.0  # [1/m] in the middle of the string
CURVATURE = "rest_curvature.curvature"


@pytest.fixture(scope="module")
def hypothesis(arm):
    base = Hypothesis(with_second_order_mesh(ordinary(arm)))
    return base.with_cause(effects_by_name()["rest_curvature"])


def simulate_curved_strings(arm, hypothesis, offsets):
    """Simulate trials with different curvatures [1/m]; fit the common one."""
    rng = np.random.default_rng(0)
    places = np.array([4, 8, 12, 16, 20])
    model = hypothesis.model
    shared = {**TRUTH, CURVATURE: MEAN_CURVATURE, "rest_curvature.slope": 0.0}
    trials = []
    for k, angles in enumerate(swing_angles(arm, TRIALS, 0.3)):
        values = shared | {CURVATURE: MEAN_CURVATURE + offsets[k]}
        trial = simulate_trial(f"t{k}", arm, model, values, angles, places, rng)
        trials.append(prepare_trial(model, trial))
    chi = hypothesis.model.exponents_of_values(shared)
    base = Hypothesis(hypothesis.base)
    plain = attach_discrepancy_model(trials, base, chi[hypothesis.base_indices])
    fit = evaluate_fit(plain, hypothesis, chi)
    return attach_discrepancy_model(trials, hypothesis, chi), fit


def test_curvatures_that_vary_are_estimated_with_their_mean(arm, hypothesis):
    """The mean is as accurate as four trials can determine it."""
    offsets = np.array([0.6, -0.5, 0.3, -0.4])
    data, plain = simulate_curved_strings(arm, hypothesis, offsets)
    assert data.between_trial_tip_rms("rest_curvature") > 0
    fit = fit_hypothesis(data, hypothesis, plain.chi[None], plain.grid_points)
    assert fit.log_likelihood_by_trial.sum() > plain.log_likelihood_by_trial.sum() + 20
    tolerance = 2 * offsets.std() / np.sqrt(TRIALS)
    mean = MEAN_CURVATURE + offsets.mean()
    assert fit.values[CURVATURE] == pytest.approx(mean, abs=tolerance)

    # Random effects do not replace the common curvature
    without = fit_hypothesis(
        data,
        hypothesis.without_cause(effects_by_name()["rest_curvature"]),
        plain.chi[None, hypothesis.base_indices],
        plain.grid_points,
    )
    assert fit.log_evidence > without.log_evidence + 20


def test_curvatures_that_are_equal_need_no_random_effect(arm, hypothesis):
    data, _ = simulate_curved_strings(arm, hypothesis, np.zeros(TRIALS))
    assert data.between_trial_tip_rms("rest_curvature") == 0
    assert not data.random_effects
