"""A solution at the limit of the mesh is that of the string itself."""

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import JOINTS
from stringcast.stages.inference.covariance import linearise, parameter_covariance
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh_limit import refine_at_mesh_limit
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.search import refine_solution
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.parameter import parameter_exponents
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
SWING_RAD = 0.15  # of each joint: the hand moves at 0.5 m/s


def fit_slow_swing(chain, name):
    """Fit the coarse mesh to a slow swing of one of the lab's strings.

    Returns the likelihood, its solution and the true exponents.
    """
    truth = chain.string.values(read_block(f"specimen/{name}.yaml")["parameters"])
    t = np.arange(0, END + 1e-9, COARSE.arm.tick)
    log = {"t": t}
    for number, joint in enumerate(JOINTS):
        swing = np.sin((5 + number) * t) ** 2
        log[joint] = START_RAD[number] + SWING_RAD * swing
    rng = np.random.default_rng(0)
    trial = observe_cast("look", chain, truth, pd.DataFrame(log), rng, NOISE)
    trials = (prepare_trial(COARSE, trial),)
    chi = parameter_exponents(COARSE.parameters, truth)
    likelihood = Likelihood(TrialData(trials), COARSE)
    return *refine_solution(likelihood, chi), chi


def standard_errors_off(likelihood, chi, truth, name):
    """Return how far a parameter is from its true exponent, in standard errors."""
    covariance = parameter_covariance(linearise(likelihood, chi))
    number = COARSE.names.index(name)
    deviation = np.sqrt(covariance.matrix[number, number])
    return abs(chi[number] - truth[number]) / deviation


@pytest.mark.parametrize("name", ["A", "C"])
def test_a_coarse_mesh_shows_the_stiffness_of_the_string_itself(name):
    likelihood, chi, truth = fit_slow_swing(FAR_FINER, name)
    stiffness = "bending_stiffness"
    assert standard_errors_off(likelihood, chi, truth, stiffness) > 6
    corrected, best = refine_at_mesh_limit(likelihood, chi)
    assert standard_errors_off(corrected, best, truth, stiffness) < 3
    assert corrected.noise_scales[0] < likelihood.noise_scales[0]


def test_a_mesh_that_hardly_resolves_a_string_loses_nine_tenths_of_its_error():
    """String D bends over 18 mm, and the segments are 16 mm long."""
    likelihood, chi, truth = fit_slow_swing(FAR_FINER, "D")
    _, best = refine_at_mesh_limit(likelihood, chi)
    stiffness = COARSE.names.index("bending_stiffness")
    before = abs(chi - truth)[stiffness]
    assert before > 0.03  # a third of its value
    assert abs(best - truth)[stiffness] < 0.1 * before


def test_what_is_measured_of_the_mesh_itself_is_not_corrected():
    likelihood, chi, _ = fit_slow_swing(COARSE, "D")
    corrected, best = refine_at_mesh_limit(likelihood, chi)
    assert corrected is likelihood
    assert best is chi
