"""What trials can tell before causes are sought: by answers that are known, and by data
made with what is said.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary

from stringcast.stages.check.overview import detection_limit_text
from stringcast.stages.diagnose.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.identifiability import detection_limits
from stringcast.stages.diagnose.measures import fixed_leave_one_out_gain
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.camera_offset import CameraOffset
from stringcast.stages.model.effects.contact import Contact
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.effects.wind import Wind
from tests.diagnosis.performed import CRITERIA, performed, swings

ANY_SIZE = replace(CRITERIA, min_tip_shift_m=1e-6)
ASKED = (ArmLag, CameraOffset, Contact, TimeOffset, Wind)


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


def seen(arm, model, values, seed):
    """Three swings of which three places were seen, as cases."""
    rng, places = np.random.default_rng(seed), np.array([8, 14, 20])
    made = [
        performed(f"t{k}", arm, model, values, each, places, rng)
        for k, each in enumerate(swings(arm, 3, 0.4))
    ]
    return tuple(prepare_trial(model, trial) for trial in made)


def start(hypothesis):
    """Exponents (P,) of the string as it is, without causes."""
    base = hypothesis.base.parameters
    return hypothesis.exponents_from(
        {p.name: float(p.chi(np.asarray(TRUTH[p.name]))) for p in base}
    )


def ready(arm, model, values, seed):
    """Data of three swings, and the base model fitted to them from where the string is."""
    cases, hypothesis = seen(arm, model, values, seed), Hypothesis(model)
    data = attach_discrepancy_model(cases, hypothesis, start(hypothesis))
    fit = fit_hypothesis(
        data, hypothesis, start(hypothesis)[None], np.zeros(3, dtype=int)
    )
    return PreparedData(
        data,
        evaluate_fit(data, hypothesis, fit.chi),
        cases,
        cases,
        0,
        np.zeros(3),
        mesh_is_model=True,
    )


@pytest.fixture(scope="module")
def plain(arm, model):
    return ready(arm, model, TRUTH, 0)


@pytest.fixture(scope="module")
def told(plain):
    found = detection_limits(plain, ASKED, ANY_SIZE, 0)
    return {f"{each.effect.name}.{each.parameter.name}": each for each in found}


def test_a_camera_that_is_off_moves_the_tip_by_as_much(told):
    for axis in ("x", "y"):
        each = told[f"camera_offset.{axis}"]
        assert each.detectable_tip_shift_m == pytest.approx(
            each.detectable_value, rel=1e-6
        )
        assert each.max_tip_shift_m == pytest.approx(each.parameter.high, rel=1e-6)


def test_what_depends_on_place_is_not_asked_and_all_else_is(told):
    assert set(told) == {
        *(
            "arm_lag.time_constant",
            "camera_offset.x",
            "camera_offset.y",
            "time_offset.offset",
        ),
        *("wind.along_x", "wind.along_y"),
    }


@pytest.mark.parametrize("name", ["wind.along_x", "time_offset.offset"])
def test_the_tip_moves_as_far_as_is_said_where_it_is_simulated(plain, told, name):
    each, base = told[name], plain.base_fit
    hypothesis = base.hypothesis.with_cause(each.effect)
    chi = hypothesis.exponents_from(
        base.exponents
        | {name: float(each.parameter.chi(np.asarray(each.detectable_value)))}
    )
    there = [one[0] for one in plain.data.residuals(hypothesis.model, chi[None])]
    moved = plain.data.tip_rms_by_trial(
        [a - b for a, b in zip(there, base.residuals, strict=True)]
    )
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(
        each.detectable_tip_shift_m, rel=0.02
    )


@pytest.mark.parametrize(("times", "found"), [(0.5, False), (2.0, True)])
def test_an_effect_is_evident_from_the_size_on_that_is_said(
    arm, model, told, times, found
):
    """In most of five sets of trials that are made with it, by fits without it and with
    it.
    """
    windy, base = Hypothesis(model).with_cause(Wind), Hypothesis(model)
    strength = {
        "wind.along_x": times * told["wind.along_x"].detectable_value,
        "wind.along_y": 0.0,
    }
    evident = []
    for seed in range(1, 6):
        cases = seen(arm, windy.model, TRUTH | strength, seed)
        chi = start(base)
        data = attach_discrepancy_model(
            [replace(each, model=model) for each in cases], base, chi
        )
        plain, fit = (
            fit_hypothesis(data, h, start(h)[None], np.zeros(3, dtype=int))
            for h in (base, windy)
        )
        evident.append(
            fixed_leave_one_out_gain(plain, fit) > CRITERIA.min_log_bayes_factor
        )
    assert (np.mean(evident) > 0.5) == found


def test_a_least_size_is_asked_for_beside_the_evidence(plain, told):
    name = "camera_offset.x"
    (each, *_) = detection_limits(
        plain, [CameraOffset], replace(CRITERIA, min_tip_shift_m=0.05), 0
    )
    assert told[name].detectable_tip_shift_m < 0.05
    assert each.detectable_tip_shift_m == pytest.approx(0.05, rel=1e-6)
    (none, *_) = detection_limits(
        plain, [CameraOffset], replace(CRITERIA, min_tip_shift_m=0.2), 0
    )
    assert np.isnan([none.detectable_value, none.detectable_tip_shift_m]).all()


def test_look_alikes_are_named_and_others_are_not(told):
    """A lag is a delay in slow motion, and neither is wind or a camera that is off."""
    assert told["arm_lag.time_constant"].lookalikes == ("time_offset",)
    assert told["time_offset.offset"].lookalikes == ("arm_lag",)
    assert {told[name].lookalikes for name in told if name[:3] in ("cam", "win")} == {
        ()
    }


def test_sizes_are_said_in_plain_units(told):
    assert (
        detection_limit_text(
            {"unit": "s", "absent": 0.0, "found_from": 1.1e-4, "most_tip_m": 0.2}
        )
        == "0.11 ms"
    )
    assert (
        detection_limit_text(
            {"unit": "1", "absent": 1.0, "found_from": 1.02, "most_tip_m": 0.2}
        )
        == "100 % to 102 %"
    )
    assert (
        detection_limit_text(
            {"unit": "m", "absent": 0.0, "found_from": None, "most_tip_m": 2e-4}
        )
        == "never: 0.2 mm at most"
    )
