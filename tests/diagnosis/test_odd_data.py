"""Unusual data: unusable trials, trials that begin moving, and missing numbers."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import SWING, sample_curve

from stringcast.data.artifacts import JOINTS, MASKS, READINGS, Observation
from stringcast.data.diagnoses import HELD_OUT
from stringcast.pipeline.settings.model_settings import read_parameter_values
from stringcast.stages.diagnose.evidence.predictions import (
    RATED_FRAMES,
    TrialPrediction,
    matching_rate,
    matching_target,
    with_rated_frames,
)
from stringcast.stages.diagnose.results.document import (
    extended_model_settings,
    gain_document,
    replace_non_finite,
    widened_ranges,
)
from stringcast.stages.diagnose.trials.preparation import usable_trials
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial

S = np.array([0.1, 0.2, 0.3])
FINE_MATCHING = Matching(dilations=20, step_px=1, tip_step_px=1.0, delta_w=0.25)
GAIN_BLOCKS = {
    "rms_m": {"base", "extended", "noise_floor"},
    "tip_rms_m": {"base", "extended"},
    "matching_rate": {"base", "extended"},
    "log_likelihood_per_trial": {"difference", "standard_error"},
}


@pytest.fixture(scope="module")
def model(arm):
    return ordinary(arm)


@pytest.fixture(scope="module")
def moving_trial(arm, model):
    """Simulate a swing whose first fifth of a second was not filmed."""
    control = np.zeros((1, 3, 6))
    control[0, :, 1:-1] = 3 * SWING
    angles = sample_curve(arm, control, 0.5)
    t = arm.tick * np.arange(len(angles))
    joints = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
    empty = (READINGS.empty(), MASKS.empty())
    unseen = Observation(
        "t0", points_table(t, np.zeros((len(t), 3, 2))), *empty, joints
    )
    motion = prepare_trial(model, unseen).motion
    strings = model.simulate_observation(motion, model.values(TRUTH)[None], t)
    places = np.searchsorted(model.string.arc_lengths(), S - 1e-9)
    points = points_table(t, strings.points[0][:, places]).query("t > 0.2")
    return replace(unseen, points=points, starts_moving=True)


def points_table(t, points):
    """Arrange points (F, 3, 2) as a table."""
    x, y = points.reshape(-1, 2).T
    s = np.tile(S, len(t))
    columns = {"t": np.repeat(t, len(S)), "s": s, "x": x, "y": y, "sigma": 1e-3}
    return pd.DataFrame(columns)


def test_unusable_trials_are_rejected_with_the_reason(model, moving_trial):
    """Unusable trials are rejected with the reason, and the others are diagnosed."""
    points = moving_trial.points
    unread = replace(moving_trial, trial="t1", points=points.assign(valid=False))
    short = replace(moving_trial, trial="t2", points=points[points["t"] < 0.211])
    usable, faults = usable_trials(model, [moving_trial, unread, short])
    assert [observation.trial for observation in usable] == ["t0"]
    assert "no valid point" in faults["t1"]
    assert "begins moving" in faults["t2"]
    assert not any(reason.startswith("trial") for reason in faults.values())


def test_matching_rate_uses_the_initial_state_of_the_whole_trial(model, moving_trial):
    """The twenty rated frames are too far apart to estimate the state."""
    count = with_rated_frames(moving_trial).points["t"].nunique()
    assert RATED_FRAMES <= count < 2 * RATED_FRAMES
    trial = prepare_trial(model, moving_trial)
    hypothesis = Hypothesis(model)
    chi = hypothesis.model.exponents_of_values(TRUTH)
    prediction = TrialPrediction(hypothesis, chi, np.zeros(0), 0.0)
    state = trial.initial_state
    turned = replace(trial, initial_state=replace(state, angle=state.angle + 0.5))
    rates = []
    for prepared in (trial, turned):
        target = matching_target(model, prepared, moving_trial, FINE_MATCHING)
        rates.append(matching_rate(target, prediction))
    assert rates[0] > 0.8
    assert rates[1] < rates[0] - 0.3


def held_out_rows(**columns):
    """Make a table HELD_OUT of two trials."""
    numbers = {c.name: [0.003, 0.004] for c in HELD_OUT.columns if c.kind == "float"}
    return HELD_OUT.check(pd.DataFrame({"trial": ["t0", "t1"]} | numbers | columns))


def blocks_of(document):
    """Select the blocks of a document."""
    return {name: block for name, block in document.items() if isinstance(block, dict)}


def test_the_gain_has_all_fields_even_if_no_trial_was_left_out():
    full = replace_non_finite(gain_document(held_out_rows(), ()))
    assert {name: set(block) for name, block in blocks_of(full).items()} == GAIN_BLOCKS
    assert full["rms_m"]["base"] == pytest.approx(np.sqrt(12.5) * 1e-3)
    empty = replace_non_finite(gain_document(HELD_OUT.empty(), ()))
    assert empty["held_out_trials"] == []
    assert blocks_of(empty).keys() == GAIN_BLOCKS.keys()
    for block in blocks_of(empty).values():
        assert set(block.values()) == {None}


def test_gain_is_valid_json():
    """The gain is valid JSON without its undefined numbers.

    One trial has no standard error, a rejected run no matching rate.
    """
    one_trial = held_out_rows(E_extended=[np.nan, np.nan])[:1]
    document = replace_non_finite(gain_document(one_trial, ()))
    json.dumps(document, allow_nan=False)
    rate = document["matching_rate"]
    assert rate == {"base": pytest.approx(0.003), "extended": None}
    assert document["log_likelihood_per_trial"]["standard_error"] is None
    nested = {"a": [(1, "b", float("inf"))]}
    assert replace_non_finite(nested) == {"a": [[1, "b", None]]}


def test_widened_ranges_are_passed_to_other_stages(model):
    string = model.string
    wide = replace(string.parameters[2], high=1e9)
    other = replace(string, ranges={**string.ranges, wide.name: wide})
    expected = {wide.name: {"low": wide.low, "high": 1e9}}
    assert widened_ranges(string, other) == expected
    assert widened_ranges(string, string) == {}


def test_an_interval_without_width_is_written_as_a_value(model):
    """The next command would refuse an empty interval at the end of a range."""
    hypothesis = Hypothesis(model)
    values = dict(zip(model.names, model.values(TRUTH), strict=True))
    fit = SimpleNamespace(hypothesis=hypothesis, values=values)
    first, second = model.names[:2]
    best = values[second]
    intervals = {
        first: (values[first], values[first]),
        second: (0.9 * best, 1.1 * best),
    }
    settings = extended_model_settings(model, fit, intervals)
    written = settings["parameter_values"]
    assert written[first] == pytest.approx(values[first])
    assert written[second]["low"] < written[second]["value"] < written[second]["high"]
    read_parameter_values(written, model, "extended.yaml")
