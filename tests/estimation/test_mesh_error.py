"""What an estimate leaves of trials is what no error of its mesh explains."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.stages.common import rms
from stringcast.stages.estimate.mesh_error import (
    likely_amplitudes,
    solve_at_mesh_limit,
    subtract_uncertain_error,
)
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh_limit import refine_at_mesh_limit
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.inference.whitening import IndependentErrors
from stringcast.stages.model.model import Model
from tests.estimation.test_estimate import STRING, TRUTH, observed
from tests.inference import test_mesh_limit


def test_amplitudes_are_those_of_a_regression_with_a_normal_prior():
    """Two shapes of 4 and 1 sigma at one number each: shares of 16/17 and 1/2."""
    shapes = np.array([[4.0, 0.0], [0.0, 1.0]])
    found = likely_amplitudes(shapes, np.array([8.5, 3.0]))
    np.testing.assert_allclose(found, [2.0, 1.5])


@pytest.mark.parametrize("amplitude", [-1.5, 0.0, 1.0])
def test_an_uncertain_error_is_subtracted_as_far_as_the_trial_shows_it(
    arm, camera, amplitude
):
    """Another shape, such as of an initial state, stays in the points."""
    model = Model(STRING, arm, camera)
    trial = prepare_trial(model, observed(3))
    progress = np.linspace(0, 1, len(trial.points))
    uncertain_m = 0.01 * np.stack([progress**2, progress], axis=1)
    other_m = 0.005 * np.stack([np.cos(9 * progress), np.sin(9 * progress)], axis=1)
    shapes = [(m / trial.sigma[:, None]).ravel() for m in (other_m, uncertain_m)]
    errors = IndependentErrors(scale=1.0, nuisance=np.stack(shapes, axis=1))
    # the residual is simulated less measured
    points = trial.points - amplitude * uncertain_m - 0.7 * other_m
    shifted = replace(trial, points=points, error_model=errors)
    likelihood = Likelihood(TrialData((shifted,)), model)
    (found,) = subtract_uncertain_error(likelihood, model.exponents_of_values(TRUTH))
    left = found.points - (trial.points - 0.7 * other_m)
    assert rms(left) < 0.1e-3


def fit_swing(chain, monkeypatch):
    """Fit a coarse mesh to string D whose joints swing by 0.4 rad."""
    monkeypatch.setattr(test_mesh_limit, "SWING_RAD", 0.4)
    likelihood, chi, _ = test_mesh_limit.fit_slow_swing(chain, "D")
    return likelihood, chi


def test_a_correction_that_begins_on_a_finer_mesh_leaves_less(monkeypatch):
    """A segment of the mesh is as long as string D bends over."""
    likelihood, chi = fit_swing(test_mesh_limit.FAR_FINER, monkeypatch)
    plain, _ = refine_at_mesh_limit(likelihood, chi)
    begun_finer, _ = solve_at_mesh_limit(likelihood, chi)
    assert plain.noise_scales[0] < 0.8 * likelihood.noise_scales[0]
    assert begun_finer.noise_scales[0] < 0.8 * plain.noise_scales[0]


def test_data_of_the_mesh_itself_are_not_corrected(monkeypatch):
    likelihood, chi = fit_swing(test_mesh_limit.COARSE, monkeypatch)
    kept, same = solve_at_mesh_limit(likelihood, chi)
    assert kept is likelihood
    assert same is chi


@pytest.mark.parametrize("name", ["A", "B", "C", "D"])
def test_the_stiffness_is_that_of_the_string_itself(name):
    """A slow swing loses nine tenths of what the mesh has moved it by."""
    far_finer = test_mesh_limit.FAR_FINER
    likelihood, chi, truth = test_mesh_limit.fit_slow_swing(far_finer, name)
    corrected, best = solve_at_mesh_limit(likelihood, chi)
    assert corrected is not likelihood
    stiffness = corrected.model.names.index("bending_stiffness")
    assert abs(best - truth)[stiffness] < 0.1 * abs(chi - truth)[stiffness]
