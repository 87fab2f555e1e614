"""A trial that the others do not predict is excluded, and named with the reason."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import CRITERIA, diagnose_trials, simulate_trial, swing_angles

from stringcast.stages.diagnose.evidence.predictions import improves_predictions
from stringcast.stages.diagnose.trials import outlying_trials
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.trials.outlying_trials import find_outlying_trial
from stringcast.stages.model.library import effects_by_name


@pytest.mark.parametrize(
    ("errors_mm", "outlying"),
    [
        ((3.0, 2.0, 40.0, 2.5), ["t2"]),
        ((3.0, 2.0, 15.0, 2.5), []),  # the same model misfits more in a faster motion
        ((0.1, 0.1, 1.8, 0.1), []),  # below the tolerance
        ((2.0, 2.0, 60.0), []),  # two trials are too few against one
    ],
)
def test_only_a_trial_far_from_the_others_is_outlying(errors_mm, outlying, monkeypatch):
    errors_m = np.array(errors_mm) / 1e3
    monkeypatch.setattr(outlying_trials, "tip_errors", lambda *given: errors_m)
    trials = [SimpleNamespace(name=f"t{k}") for k in range(len(errors_mm))]
    data = SimpleNamespace(trials=trials)
    state = SimpleNamespace(prepared=SimpleNamespace(data=data), predictions=None)
    assert list(find_outlying_trial(state, CRITERIA)) == outlying


def prediction(size, log_likelihood):
    return SimpleNamespace(residual=np.full(4, size), log_likelihood=log_likelihood)


def test_one_trial_does_not_decide_against_the_others_which_model_predicts_better():
    base = [prediction(10.0, -100.0)] * 4
    extended = [prediction(1.0, -10.0)] * 3 + [prediction(50.0, -9e9)]
    assert improves_predictions(base, extended)
    assert not improves_predictions(extended, base)


@pytest.mark.long
def test_causes_are_found_despite_a_trial_of_another_motion(arm):
    """The joints have a gain error of 3 %; one trial has the points of another."""
    real = with_second_order_mesh(ordinary(arm))
    real = real.with_effects(effects_by_name()["joint_gain"]).with_segments(80)
    values = TRUTH | {"joint_gain.gain": 0.03}
    rng = np.random.default_rng(5)
    places = np.arange(8, 81, 8)
    trials = []
    for k, angles in enumerate(swing_angles(arm, 4)):
        trials.append(simulate_trial(f"t{k}", arm, real, values, angles, places, rng))
    trials[3] = replace(trials[3], points=trials[1].points)

    diagnosis = diagnose_trials(ordinary(arm), trials, 4)
    (row,) = diagnosis.finding.to_dict("records")
    assert row["verdict"] == "effect"
    assert "t3: the others predict its tip to" in row["sentence"]
    assert list(diagnosis.causes["effect"].unique()) == ["joint_gain"]
