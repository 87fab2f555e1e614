"""A cause that differs from trial to trial: one size that all share, and each trial its
own about it.
"""

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, swings

from stringcast.stages.diagnose.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.parameter import parameter_exponents

TRIALS = 4
SET = 2.0  # [1/m] in the middle of the string, on average over trials
CURVATURE = "rest_curvature.curvature"


@pytest.fixture(scope="module")
def hypothesis(arm):
    """A string with a set."""
    return Hypothesis(with_second_order_mesh(ordinary(arm))).with_cause(
        effects_by_name()["rest_curvature"]
    )


def seen(arm, hypothesis, offsets):
    """Data of trials whose sets differ by these offsets [1/m], the shared one being
    fitted first.
    """
    rng, places, model = (
        np.random.default_rng(0),
        np.array([4, 8, 12, 16, 20]),
        hypothesis.model,
    )
    sets = [
        {**TRUTH, CURVATURE: SET + off, "rest_curvature.slope": 0.0} for off in offsets
    ]
    pairs = enumerate(zip(sets, swings(arm, TRIALS, 0.3), strict=True))
    trials = [
        prepare_trial(model, performed(f"t{k}", arm, model, own, angles, places, rng))
        for k, (own, angles) in pairs
    ]
    shared = {**TRUTH, CURVATURE: SET, "rest_curvature.slope": 0.0}
    chi = parameter_exponents(
        hypothesis.parameters, np.array([shared[p.name] for p in hypothesis.parameters])
    )
    plain = evaluate_fit(
        attach_discrepancy_model(
            trials, Hypothesis(hypothesis.base), chi[hypothesis.base_indices]
        ),
        hypothesis,
        chi,
    )
    return attach_discrepancy_model(trials, hypothesis, chi), plain


def test_sets_that_differ_are_told_with_the_one_that_they_share(arm, hypothesis):
    """The shared one is their mean, as well as four trials tell it."""
    offsets = np.array([0.6, -0.5, 0.3, -0.4])
    data, plain = seen(arm, hypothesis, offsets)
    assert data.between_trial_tip_rms("rest_curvature") > 0
    fit = fit_hypothesis(data, hypothesis, plain.chi[None], plain.scale_indices)
    assert fit.log_likelihood_by_trial.sum() > plain.log_likelihood_by_trial.sum() + 20
    assert fit.values[CURVATURE] == pytest.approx(
        SET + offsets.mean(), abs=2 * offsets.std() / np.sqrt(TRIALS)
    )
    less = fit_hypothesis(
        data,
        hypothesis.without_cause(effects_by_name()["rest_curvature"]),
        plain.chi[None, hypothesis.base_indices],
        plain.scale_indices,
    )
    # what differs about a size is no excuse for leaving that away
    assert fit.log_evidence > less.log_evidence + 20


def test_sets_that_do_not_differ_are_told_as_one(arm, hypothesis):
    data, _ = seen(arm, hypothesis, np.zeros(TRIALS))
    assert data.between_trial_tip_rms("rest_curvature") == 0
    assert not data.random_effects
