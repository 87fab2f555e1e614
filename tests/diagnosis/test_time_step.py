"""The time step: long where motion is gentle, and short where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import simulate_trial, swing_angles

from stringcast.stages.diagnose.discretisation import (
    LONGEST_STEP_S,
    discretisation_uncertainty,
    with_second_order_mesh,
)
from stringcast.stages.diagnose.time_step import (
    MAX_ADDED_UNCERTAINTY,
    lengthen_steps_while_accurate,
)
from stringcast.stages.inference import mesh
from stringcast.stages.inference.hypothesis import ABRUPT_STEP_S, Hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.library import effects_by_name

TOLERANCE_M = 2e-3


def likelihood_of_swing(arm, number):
    """Simulate a swing that is faster for a higher number."""
    model = with_second_order_mesh(ordinary(arm))
    rng = np.random.default_rng(0)
    *_, angles = swing_angles(arm, number, 0.4)
    places = np.array([8, 14, 20])
    measured = simulate_trial("t", arm, model, TRUTH, angles, places, rng)
    trial = prepare_trial(model, measured)
    return Likelihood(TrialData((trial,)), model)


@pytest.mark.parametrize(("number", "wanted_step_s"), [(1, 4e-3), (20, 2e-3)])
def test_steps_are_lengthened_while_accuracy_is_kept(arm, number, wanted_step_s):
    likelihood = likelihood_of_swing(arm, number)
    hypothesis = Hypothesis(likelihood.model)
    chi = hypothesis.model.exponents_of_values(TRUTH)
    longer = lengthen_steps_while_accurate(likelihood, chi, TOLERANCE_M, LONGEST_STEP_S)

    assert longer.model.string.largest_step == wanted_step_s <= LONGEST_STEP_S
    before_m = discretisation_uncertainty(likelihood.data.trials, hypothesis, chi)
    after_m = discretisation_uncertainty(
        longer.data.trials, Hypothesis(longer.model), chi
    )
    assert after_m <= before_m + MAX_ADDED_UNCERTAINTY * TOLERANCE_M
    assert all(trial.model is longer.model for trial in longer.data.trials)


@pytest.mark.parametrize(
    ("cause", "is_abrupt"),
    [("maxwell_slip", True), ("contact", True), ("grasp_play", True), ("wind", False)],
)
def test_causes_with_abrupt_changes_keep_short_steps(arm, cause, is_abrupt):
    base = with_second_order_mesh(ordinary(arm))
    base = replace(base, string=replace(base.string, largest_step=LONGEST_STEP_S))
    hypothesis = Hypothesis(base).with_cause(effects_by_name()[cause])
    step_s = hypothesis.model.string.largest_step
    assert step_s == (ABRUPT_STEP_S if is_abrupt else LONGEST_STEP_S)
    assert hypothesis.without_cause(hypothesis.causes[0]).model == base


def test_a_cause_does_not_lengthen_steps(arm):
    base = ordinary(arm)
    hypothesis = Hypothesis(base).with_cause(effects_by_name()["maxwell_slip"])
    assert hypothesis.model.string.largest_step == base.string.largest_step


def test_steps_are_too_long_if_a_trial_diverges(arm, monkeypatch):
    likelihood = likelihood_of_swing(arm, 1)

    def simulate_points(model, trials, values):
        step_s = model.string.largest_step
        value = np.nan if step_s > 2e-3 else 0.0
        return [np.full((1, len(trial.s), 2), value) for trial in trials]

    monkeypatch.setattr(mesh, "measured_points", simulate_points)
    chi = likelihood.model.exponents_of_values(TRUTH)
    longer = lengthen_steps_while_accurate(likelihood, chi, TOLERANCE_M, LONGEST_STEP_S)
    assert longer.model.string.largest_step == 2e-3


def test_steps_are_kept_if_no_trial_is_resolved(arm):
    likelihood = likelihood_of_swing(arm, 1)
    chi = likelihood.model.exponents_of_values(TRUTH)
    assert lengthen_steps_while_accurate(likelihood, chi, 1e-9, 4e-3) is likelihood
