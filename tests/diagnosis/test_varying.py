"""A cause that differs from trial to trial: one size that all share, and each trial its own about it."""

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, swings

from stringcast.stages.diagnose.prepared import lacking, resolved
from stringcast.stages.inference.evidence import evaluated, fitted
from stringcast.stages.inference.forward import case
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.model.library import library
from stringcast.stages.model.parameter import chi_of

TRIALS = 4
SET = 2.0  # [1/m] in the middle of the string, on average over trials
CURVATURE = "rest_curvature.curvature"


@pytest.fixture(scope="module")
def hypothesis(arm):
    """A string with a set."""
    return Hypothesis(resolved(ordinary(arm))).joined(library()["rest_curvature"])


def seen(arm, hypothesis, offsets):
    """Data of trials whose sets differ by these offsets [1/m], the shared one being fitted first."""
    rng, places, model = np.random.default_rng(0), np.array([4, 8, 12, 16, 20]), hypothesis.model
    sets = [{**TRUTH, CURVATURE: SET + off, "rest_curvature.slope": 0.0} for off in offsets]
    pairs = enumerate(zip(sets, swings(arm, TRIALS, 0.3), strict=True))
    trials = [case(model, performed(f"t{k}", arm, model, own, angles, places, rng)) for k, (own, angles) in pairs]
    shared = {**TRUTH, CURVATURE: SET, "rest_curvature.slope": 0.0}
    chi = chi_of(hypothesis.parameters, np.array([shared[p.name] for p in hypothesis.parameters]))
    plain = evaluated(lacking(trials, Hypothesis(hypothesis.base), chi[hypothesis.base_places]), hypothesis, chi)
    return lacking(trials, hypothesis, chi), plain


def test_sets_that_differ_are_told_with_the_one_that_they_share(arm, hypothesis):
    """The shared one is their mean, as well as four trials tell it."""
    offsets = np.array([0.6, -0.5, 0.3, -0.4])
    data, plain = seen(arm, hypothesis, offsets)
    assert data.differs("rest_curvature") > 0
    fit = fitted(data, hypothesis, plain.chi[None], plain.sizes)
    assert fit.by_trial.sum() > plain.by_trial.sum() + 20
    assert fit.values[CURVATURE] == pytest.approx(SET + offsets.mean(), abs=2 * offsets.std() / np.sqrt(TRIALS))
    less = fitted(
        data,
        hypothesis.without(library()["rest_curvature"]),
        plain.chi[None, hypothesis.base_places],
        plain.sizes,
    )
    assert fit.evidence > less.evidence + 20  # what differs about a size is no excuse for leaving that away


def test_sets_that_do_not_differ_are_told_as_one(arm, hypothesis):
    data, _ = seen(arm, hypothesis, np.zeros(TRIALS))
    assert data.differs("rest_curvature") == 0
    assert not data.varying
