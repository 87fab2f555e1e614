"""Detection limits of effects, compared with known answers and simulated data."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import CRITERIA, simulate_trial, swing_angles

from stringcast.stages.check.overview import detection_limit_text
from stringcast.stages.diagnose.evidence.identifiability import detection_limits
from stringcast.stages.diagnose.evidence.measures import fixed_leave_one_out_gain
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.camera_offset import CameraOffset
from stringcast.stages.model.effects.contact import Contact
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.effects.wind import Wind

ANY_SHIFT = replace(CRITERIA, tip_tolerance_m=1e-6)
EFFECTS = (ArmLag, CameraOffset, Contact, TimeOffset, Wind)
PLACES = np.array([8, 14, 20])
NO_DISCREPANCY = np.zeros(3, dtype=int)


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


def simulate_swings(arm, model, values, seed):
    """Simulate three swings with three points along the string."""
    rng = np.random.default_rng(seed)
    trials = []
    for k, angles in enumerate(swing_angles(arm, 3, 0.4)):
        trial = simulate_trial(f"t{k}", arm, model, values, angles, PLACES, rng)
        trials.append(prepare_trial(model, trial))
    return tuple(trials)


def fit_from_truth(data, hypothesis):
    """Fit a hypothesis from the true string without causes."""
    start = hypothesis.model.exponents_of_values(TRUTH)
    return fit_hypothesis(data, hypothesis, start[None], NO_DISCREPANCY)


def prepare_swings(trials, model):
    """Prepare three swings, and fit the base model from the true string."""
    hypothesis = Hypothesis(model)
    data = attach_discrepancy_model(
        trials, hypothesis, model.exponents_of_values(TRUTH)
    )
    fit = evaluate_fit(data, hypothesis, fit_from_truth(data, hypothesis).chi)
    return PreparedData(data, fit, trials, trials, 0, np.zeros(3), mesh_is_model=True)


@pytest.fixture(scope="module")
def prepared(arm, model):
    return prepare_swings(simulate_swings(arm, model, TRUTH, 0), model)


@pytest.fixture(scope="module")
def limits(prepared):
    by_name = {}
    for limit in detection_limits(prepared, EFFECTS, ANY_SHIFT, 0):
        by_name[f"{limit.effect.name}.{limit.parameter.name}"] = limit
    return by_name


def test_a_camera_offset_moves_the_tip_by_as_much(limits):
    for name in ("camera_offset.x", "camera_offset.y"):
        limit = limits[name]
        value, shift_m = limit.detectable_value, limit.detectable_tip_shift_m
        assert shift_m == pytest.approx(value, rel=1e-6)
        assert limit.max_tip_shift_m == pytest.approx(limit.parameter.high, rel=1e-6)


def test_all_effects_have_limits_except_those_that_depend_on_place(limits):
    assert set(limits) == {
        "arm_lag.time_constant",
        "camera_offset.x",
        "camera_offset.y",
        "time_offset.offset",
        "wind.along_x",
        "wind.along_y",
    }


@pytest.mark.parametrize("name", ["wind.along_x", "time_offset.offset"])
def test_the_tip_shift_at_the_limit_is_that_of_a_simulation(prepared, limits, name):
    limit = limits[name]
    base = prepared.base_fit
    hypothesis = base.hypothesis.with_cause(limit.effect)
    detectable = float(limit.parameter.chi(np.asarray(limit.detectable_value)))
    chi = hypothesis.exponents_from(base.exponents | {name: detectable})
    residuals = prepared.data.residuals(hypothesis.model, chi[None])
    pairs = zip(residuals, base.residuals, strict=True)
    shifts_m = prepared.data.tip_rms_by_trial([a[0] - b for a, b in pairs])
    rms_m = np.sqrt(np.mean(shifts_m**2))
    assert rms_m == pytest.approx(limit.detectable_tip_shift_m, rel=0.02)


@pytest.mark.parametrize(("factor", "is_evident"), [(0.5, False), (2.0, True)])
def test_an_effect_is_evident_from_the_limit_on(arm, model, limits, factor, is_evident):
    """An effect at the limit is evident in most of five datasets.

    The trials contain it and are fitted with and without it.
    """
    base = Hypothesis(model)
    windy = base.with_cause(Wind)
    strength = factor * limits["wind.along_x"].detectable_value
    truth = TRUTH | {"wind.along_x": strength, "wind.along_y": 0.0}
    evident = []
    for seed in range(1, 6):
        simulated = simulate_swings(arm, windy.model, truth, seed)
        trials = [replace(trial, model=model) for trial in simulated]
        data = attach_discrepancy_model(
            trials, base, base.model.exponents_of_values(TRUTH)
        )
        parent = fit_from_truth(data, base)
        gain = fixed_leave_one_out_gain(parent, fit_from_truth(data, windy))
        evident.append(gain > CRITERIA.min_log_bayes_factor)
    assert (np.mean(evident) > 0.5) == is_evident


def test_a_limit_also_needs_the_smallest_tip_shift(prepared, limits):
    assert limits["camera_offset.x"].detectable_tip_shift_m < 0.05
    criteria = replace(CRITERIA, tip_tolerance_m=0.05)
    (limit, *_) = detection_limits(prepared, [CameraOffset], criteria, 0)
    assert limit.detectable_tip_shift_m == pytest.approx(0.05, rel=1e-6)
    beyond_range = replace(CRITERIA, tip_tolerance_m=0.2)
    (none, *_) = detection_limits(prepared, [CameraOffset], beyond_range, 0)
    assert np.isnan([none.detectable_value, none.detectable_tip_shift_m]).all()


def test_a_size_that_is_rare_in_practice_needs_more_evidence(
    prepared, limits, monkeypatch
):
    """As in a diagnosis. If offsets of 0.01 mm are typical, one of 0.4 mm is rare."""
    rare = tuple(replace(p, typical_size=1e-5) for p in CameraOffset.parameters)
    monkeypatch.setattr(CameraOffset, "parameters", rare)
    (limit, *_) = detection_limits(prepared, [CameraOffset], ANY_SHIFT, 0)
    common = limits["camera_offset.x"].detectable_value
    assert 1.2 * common < limit.detectable_value < 3 * common


def test_only_look_alikes_are_named_as_confusable(limits):
    """Look-alikes are named, and other effects are not.

    A lag is a delay in slow motion; wind and a camera offset differ from both.
    """
    assert limits["arm_lag.time_constant"].lookalikes == ("time_offset",)
    assert limits["time_offset.offset"].lookalikes == ("arm_lag",)
    for name in ("camera_offset.x", "camera_offset.y", "wind.along_x", "wind.along_y"):
        assert limits[name].lookalikes == ()


@pytest.mark.parametrize(
    ("unit", "absent", "detectable", "max_tip_m", "text"),
    [
        ("s", 0.0, 1.1e-4, 0.2, "0.11 ms"),
        ("1", 1.0, 1.02, 0.2, "100 % to 102 %"),
        ("m", 0.0, None, 2e-4, "never: 0.2 mm at most"),
    ],
)
def test_limits_have_plain_units(unit, absent, detectable, max_tip_m, text):
    row = {"unit": unit, "absent": absent}
    row |= {"found_from": detectable, "most_tip_m": max_tip_m}
    assert detection_limit_text(row) == text
