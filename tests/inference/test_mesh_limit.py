"""Solutions at the mesh limit are those of the string itself."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import JOINTS
from stringcast.stages.common import rms
from stringcast.stages.inference.covariance import linearise, parameter_covariance
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh_limit import (
    likely_amplitudes,
    loss_at_noise,
    refine_at_mesh_limit,
    subtract_uncertain_error,
)
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.search import refine_solution
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.inference.whitening import IndependentErrors
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_exponents
from tests.estimation.test_estimate import STRING, TRUTH, simulate_swing
from tests.inference.estimation_sets import (
    END,
    NOISE,
    model,
    observe_cast,
    read_block,
)

COARSE = model(20, 1e-3)
FAR_FINER = model(153, 1.25e-4)  # 8 times as many segments
START_RAD = (0.6, -0.4, -0.3)
SWING_RAD = 0.15  # of each joint; the hand moves at 0.5 m/s


def swing_joints(swing_rad):
    """Return a log of joints that swing by an angle [rad]."""
    t = np.arange(0, END + 1e-9, COARSE.arm.tick)
    log = {"t": t}
    for number, joint in enumerate(JOINTS):
        swing = np.sin((5 + number) * t) ** 2
        log[joint] = START_RAD[number] + swing_rad * swing
    return pd.DataFrame(log)


def fit_slow_swing(chain, name, swing_rad=SWING_RAD, gain=0.0):
    """Fit the coarse mesh to a slow swing of one of the lab's strings.

    Returns the likelihood, its solution and the true exponents.

    gain: share by which joints swing further than they report.
    """
    truth = chain.string.values(read_block(f"specimen/{name}.yaml")["parameters"])
    moved = swing_joints((1 + gain) * swing_rad)
    rng = np.random.default_rng(0)
    trial = observe_cast("look", chain, truth, moved, rng, NOISE)
    trial = replace(trial, arm=swing_joints(swing_rad))
    trials = (prepare_trial(COARSE, trial),)
    chi = parameter_exponents(COARSE.parameters, truth)
    likelihood = Likelihood(TrialData(trials), COARSE)
    return *refine_solution(likelihood, chi), chi


def standard_errors_off(likelihood, chi, truth, name):
    """Return the error of a parameter's exponent in standard errors."""
    covariance = parameter_covariance(linearise(likelihood, chi))
    number = COARSE.names.index(name)
    deviation = np.sqrt(covariance.matrix[number, number])
    return abs(chi[number] - truth[number]) / deviation


@pytest.mark.parametrize("name", ["A", "C"])
def test_a_corrected_coarse_mesh_gives_the_true_stiffness(name):
    likelihood, chi, truth = fit_slow_swing(FAR_FINER, name)
    stiffness = "bending_stiffness"
    assert standard_errors_off(likelihood, chi, truth, stiffness) > 6
    corrected, best = refine_at_mesh_limit(likelihood, chi)
    assert standard_errors_off(corrected, best, truth, stiffness) < 3
    assert corrected.noise_scales[0] < likelihood.noise_scales[0]


def test_correction_removes_nine_tenths_of_the_error_of_a_barely_sufficient_mesh():
    """String D bends over 18 mm; segments are 16 mm long."""
    likelihood, chi, truth = fit_slow_swing(FAR_FINER, "D")
    _, best = refine_at_mesh_limit(likelihood, chi)
    stiffness = COARSE.names.index("bending_stiffness")
    before = abs(chi - truth)[stiffness]
    assert before > 0.03  # a third of its value
    assert abs(best - truth)[stiffness] < 0.1 * before


def test_a_correction_from_an_earlier_estimate_leaves_a_wrong_solution():
    """A look and a cast of string D were fitted with twice its stiffness."""
    likelihood, chi, truth = fit_slow_swing(FAR_FINER, "D")
    stiffness = COARSE.names.index("bending_stiffness")
    stuck = chi.copy()
    stuck[stiffness] += 0.3
    off = []
    for start in (None, truth):
        _, best = refine_at_mesh_limit(likelihood, stuck, start)
        off.append(abs(best - truth)[stiffness])
    assert off[1] < 0.01 < off[0]


def test_an_error_of_the_mesh_does_not_hide_that_the_model_is_incomplete():
    """A look at string C with a joint gain of -0.03 was not searched for a cause.

    The error of the mesh reduced the misfit, so that it was not subtracted.
    """
    likelihood, chi, truth = fit_slow_swing(FAR_FINER, "D", gain=0.05)
    corrected, best = refine_at_mesh_limit(likelihood, chi)
    scales = likelihood.noise_scales
    loss = loss_at_noise(likelihood, chi, scales)
    assert loss_at_noise(corrected, best, scales) > loss
    stiffness = COARSE.names.index("bending_stiffness")
    off = abs(np.stack([chi, best]) - truth)[:, stiffness]
    assert off[1] < 0.5 * off[0]


def test_data_of_the_mesh_itself_are_not_corrected():
    likelihood, chi, _ = fit_slow_swing(COARSE, "D")
    corrected, best = refine_at_mesh_limit(likelihood, chi)
    assert corrected is likelihood
    assert best is chi


def test_corrections_of_a_soft_string_start_from_a_finer_mesh():
    """From the solution on the mesh itself, the noise was a quarter larger."""
    likelihood, chi, _ = fit_slow_swing(FAR_FINER, "D", swing_rad=0.4)
    corrected, _ = refine_at_mesh_limit(likelihood, chi)
    assert corrected.noise_scales[0] < 0.64 * likelihood.noise_scales[0]


def test_amplitudes_are_those_of_a_regression_with_a_normal_prior():
    """Two shapes of 4 and 1 sigma in one residual each have shares of 16/17 and 1/2."""
    shapes = np.array([[4.0, 0.0], [0.0, 1.0]])
    found = likely_amplitudes(shapes, np.array([8.5, 3.0]))
    np.testing.assert_allclose(found, [2.0, 1.5])


@pytest.mark.parametrize("amplitude", [-1.5, 0.0, 1.0])
def test_an_uncertain_error_is_subtracted_with_its_estimated_amplitude(
    arm, camera, amplitude
):
    """Another shape, such as that of an initial state, stays in the points."""
    model = Model(STRING, arm, camera)
    trial = prepare_trial(model, simulate_swing(3))
    progress = np.linspace(0, 1, len(trial.points))
    uncertain_m = 0.01 * np.stack([progress**2, progress], axis=1)
    other_m = 0.005 * np.stack([np.cos(9 * progress), np.sin(9 * progress)], axis=1)
    shapes = [(m / trial.sigma[:, None]).ravel() for m in (other_m, uncertain_m)]
    errors = IndependentErrors(scale=1.0, nuisance=np.stack(shapes, axis=1))
    # the residual is simulated minus measured
    points = trial.points - amplitude * uncertain_m - 0.7 * other_m
    shifted = replace(trial, points=points, error_model=errors)
    likelihood = Likelihood(TrialData((shifted,)), model)
    (found,) = subtract_uncertain_error(likelihood, model.exponents_of_values(TRUTH))
    left = found.points - (trial.points - 0.7 * other_m)
    assert rms(left) < 0.1e-3
