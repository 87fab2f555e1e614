"""The mesh: coarse where it is accurate, and fine where it must be."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import simulate_trial, swing_angles

from stringcast.stages.diagnose.trials.discretisation import (
    discretisation_uncertainty,
    with_second_order_mesh,
)
from stringcast.stages.diagnose.trials.mesh_choice import (
    MAX_ADDED_UNCERTAINTY,
    choose_mesh,
)
from stringcast.stages.inference import mesh
from stringcast.stages.inference.hypothesis import ABRUPT_STEP_S, Hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.library import effects_by_name

TOLERANCE_M = 2e-3
LONG_STEP_S = 4e-3
STIFF = TRUTH | {"bending_stiffness": 300.0, "bending_damping": 0.5}


def likelihood_of_swing(arm, number, truth=TRUTH):
    """Simulate a swing that is faster for a higher number."""
    model = with_second_order_mesh(ordinary(arm))
    rng = np.random.default_rng(0)
    *_, angles = swing_angles(arm, number, 0.4)
    places = np.array([8, 14, 20])
    measured = simulate_trial("t", arm, model, truth, angles, places, rng)
    trial = prepare_trial(model, measured)
    return Likelihood(TrialData((trial,)), model)


@pytest.mark.parametrize(
    ("number", "truth", "segments", "step_s"),
    [(1, TRUTH, 20, 4e-3), (20, TRUTH, 20, 2e-3), (1, STIFF, 10, 4e-3)],
)
def test_the_mesh_is_coarsened_while_accuracy_is_kept(
    arm, number, truth, segments, step_s
):
    likelihood = likelihood_of_swing(arm, number, truth)
    hypothesis = Hypothesis(likelihood.model)
    chi = hypothesis.model.exponents_of_values(truth)
    chosen = choose_mesh(likelihood, chi, TOLERANCE_M)

    assert chosen.model.string.points == segments + 1
    assert chosen.model.string.largest_step == step_s
    before_m = discretisation_uncertainty(likelihood.data.trials, hypothesis, chi)
    after_m = discretisation_uncertainty(
        chosen.data.trials, Hypothesis(chosen.model), chi
    )
    assert after_m <= before_m + MAX_ADDED_UNCERTAINTY * TOLERANCE_M
    assert all(trial.model is chosen.model for trial in chosen.data.trials)
    assert choose_mesh(likelihood, chi, TOLERANCE_M, False) is likelihood


@pytest.mark.parametrize(
    ("cause", "is_abrupt"),
    [("maxwell_slip", True), ("contact", True), ("grasp_play", True), ("wind", False)],
)
def test_causes_with_abrupt_changes_keep_short_steps(arm, cause, is_abrupt):
    base = with_second_order_mesh(ordinary(arm))
    base = replace(base, string=replace(base.string, largest_step=LONG_STEP_S))
    hypothesis = Hypothesis(base).with_cause(effects_by_name()[cause])
    step_s = hypothesis.model.string.largest_step
    assert step_s == (ABRUPT_STEP_S if is_abrupt else LONG_STEP_S)
    assert hypothesis.without_cause(hypothesis.causes[0]).model == base


def test_a_cause_does_not_lengthen_steps(arm):
    base = ordinary(arm)
    hypothesis = Hypothesis(base).with_cause(effects_by_name()["maxwell_slip"])
    assert hypothesis.model.string.largest_step == base.string.largest_step


def test_a_mesh_on_which_a_trial_diverges_is_not_chosen(arm, monkeypatch):
    likelihood = likelihood_of_swing(arm, 1)

    def simulate_points(model, trials, values):
        is_long = model.string.largest_step > 2e-3
        return points_of(trials, np.nan if is_long else 0.0)

    monkeypatch.setattr(mesh, "measured_points", simulate_points)
    chi = likelihood.model.exponents_of_values(TRUTH)
    assert choose_mesh(likelihood, chi, TOLERANCE_M).model.string.largest_step == 2e-3


def test_steps_are_halved_if_that_resolves_a_trial(arm, monkeypatch):
    """A vibration that is hardly damped may be unstable at the given step."""
    likelihood = likelihood_of_swing(arm, 1)

    def simulate_points(model, trials, values):
        step_s = model.string.largest_step
        segment_share = 20 / (model.string.points - 1)
        return points_of(trials, np.nan if step_s > 0.5e-3 * segment_share else 0.0)

    monkeypatch.setattr(mesh, "measured_points", simulate_points)
    chi = likelihood.model.exponents_of_values(TRUTH)
    for may_be_coarser, segments, step_s in ((True, 10, 1e-3), (False, 20, 0.5e-3)):
        string = choose_mesh(likelihood, chi, TOLERANCE_M, may_be_coarser).model.string
        assert string.points == segments + 1
        assert string.largest_step == step_s


def points_of(trials, value):
    """Return a constant at all points of trials."""
    return [np.full((1, len(trial.s), 2), value) for trial in trials]


def test_the_mesh_is_kept_if_no_trial_is_resolved(arm):
    likelihood = likelihood_of_swing(arm, 1)
    chi = likelihood.model.exponents_of_values(TRUTH)
    assert choose_mesh(likelihood, chi, 1e-9) is likelihood
