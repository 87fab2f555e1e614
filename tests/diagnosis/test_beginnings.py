"""Trials that begin moving: what another beginning could explain says nothing of causes, and causes remain."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, threads

from stringcast.stages.diagnose import beginning
from stringcast.stages.diagnose.beginning import begun, doubted_beginnings, move_at_first
from stringcast.stages.diagnose.evidence import SHORTER, Evidence
from stringcast.stages.diagnose.theory import Theory
from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.inference.batch import _batches, seen_together
from stringcast.stages.inference.forward import Case
from stringcast.stages.model.hand import joint_motion
from stringcast.stages.model.library import named
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import State
from stringcast.stages.model.string import String

SIGMA = 7e-4
LENGTH = 0.3


@pytest.fixture(scope="module")
def model(arm, camera):
    plain = Model(String(LENGTH, points=15, tip_cell=0.5, grasp_cell=0.5), arm, camera)
    return plain.with_effects(*named(["wind"]))


def leaning(turn, rate):
    """A string that leans by `turn` [rad] from straight down at its end, where it turns by `rate` [rad/s]."""
    s = np.linspace(0, LENGTH, 41)
    return State(0.0, s, -np.pi / 2 + turn * s / LENGTH, rate * s / LENGTH)


@pytest.fixture(scope="module")
def evidence(model):
    """A release in a wind of 0.3 m/s, told to begin a little otherwise than it does."""
    still = np.zeros((400, 3)) + plain_cast(model.arm, 0.5).start
    motion, t = joint_motion(0.005 * np.arange(400), still), np.arange(0, 1.0, 0.005)
    values = model.values({**TRUTH, "wind.along_x": 0.3, "wind.along_y": 0.0})[None]
    seen = model.seen(motion, values, t, leaning(0.5, 0.0)).points[0][:, ::2]
    noise = SIGMA * np.random.default_rng(0).standard_normal(seen.shape)
    s = np.tile(model.string.arc_lengths()[::2], len(t))
    frame, sigma = np.repeat(np.arange(len(t)), seen.shape[1]), np.full(len(s), SIGMA)
    case = Case("t", model, motion, t, frame, s, (seen + noise).reshape(-1, 2), sigma, leaning(0.52, 0.4))
    return Evidence((case,), (14,))


def exponents(model, wind=0.0):
    """Of the truth, but for a wind to the right [m/s]."""
    return Theory(model, (), model.names).at({**TRUTH, "wind.along_x": wind, "wind.along_y": 0.0})


def size(evidence, model, wind):
    """Root mean square of the residual over sigma, with a wind to the right [m/s]."""
    return float(np.sqrt(np.mean(evidence.residuals(model, exponents(model, wind)[None]) ** 2)))


def test_another_beginning_explains_itself_and_no_wind(model, evidence):
    sure = doubted_beginnings(evidence, model, exponents(model))
    assert move_at_first(evidence)
    assert size(evidence, model, 0.3) > 2.5  # measured: 2.9
    assert size(sure, model, 0.3) == pytest.approx(1.0, abs=0.1)
    assert size(sure, model, 0.0) > 2


def test_a_beginning_is_found_anew_with_the_cause(model, evidence):
    """Then the residual is that of noise without any allowance."""
    assert size(begun(evidence, model, exponents(model, 0.3)), model, 0.3) == pytest.approx(1.0, abs=0.1)


def test_trials_that_begin_at_rest_have_nothing_to_doubt(model, evidence):
    rest = Evidence((replace(evidence.cases[0], initial=None), evidence.cases[0]), (14,))
    both = doubted_beginnings(rest, model, exponents(model))
    assert both.unsure[0].shape[1] == 0
    assert both.unsure[1].shape[1] > 0
    assert both.only([0]).unsure[0] is both.unsure[0]
    plain, doubted = (each.residuals(model, exponents(model)[None])[0][rest.trial == 0] for each in (rest, both))
    np.testing.assert_array_equal(plain, doubted)


def test_trials_side_by_side_are_as_they_are_alone(model, evidence):
    """To the bit, however long they or their hands are, whether they begin moving or not, however many share a batch,
    and whatever each candidate's clock and joints do."""
    late = model.with_effects(*named(["time_offset", "arm_lag"]))
    [case] = (replace(each, model=late) for each in evidence.cases)
    swung = joint_motion(
        0.005 * np.arange(90), plain_cast(model.arm, 0.5).start + 0.3 * np.sin(0.05 * np.arange(90))[:, None]
    )
    rest = [replace(case.until(share), initial=None) for share in (1.0, 0.4)]
    moving = [case, case.until(0.7), replace(case, initial=leaning(0.1, -0.2)), case.until(0.02)]
    cases = [*moving, *rest, *(replace(each, motion=swung) for each in (*moving, *rest))]
    values = late.values({**TRUTH, "time_offset.offset": 0.003, "arm_lag.time_constant": 0.01})
    values = values * np.linspace(0.9, 1.1, 7)[:, None]
    every = seen_together(late, cases, values)
    for own, seen in zip(cases, every, strict=True):
        np.testing.assert_array_equal(seen, late.seen(own.motion, values, own.times, own.initial).points)
    with threads(1):
        for seen, again in zip(every, seen_together(late, cases, values), strict=True):
            np.testing.assert_array_equal(seen, again)


@pytest.mark.parametrize(
    ("seconds", "rounds", "together"),
    [
        ([1.0, 1.0, 1.0], 0.3, [[0, 1, 2]]),  # all of three fill one round
        ([1.0, 0.2, 0.3], 0.5, [[1, 2], [0]]),  # the short ones should not last as long as the long one
        ([1.0, 1.0], 3.0, [[0], [1]]),  # each fills the cores by itself
    ],
)
def test_trials_go_together_where_that_takes_less_time(seconds, rounds, together):
    assert _batches(seconds, rounds) == together


def test_beginnings_are_found_with_steps_that_bear_what_was_fitted(model, evidence, monkeypatch):
    """A fit may live on shorter steps than the model's; told that these tear its string, so does its beginning."""
    chi = exponents(model, 0.3)
    [case] = begun(evidence, model, chi).cases
    assert case.model.string.largest_step == model.string.largest_step
    monkeypatch.setattr(beginning, "torn", lambda points, length: np.array([True]))
    [case] = begun(evidence, model, chi).cases
    assert case.model.string.largest_step == model.string.largest_step / SHORTER
    again = replace(evidence, cases=(case,))
    assert size(again, model, 0.3) < 1.1 < size(evidence, model, 0.3)
