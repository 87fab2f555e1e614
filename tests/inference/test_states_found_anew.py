"""Trials that begin moving, in states that are found anew beside each fit."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.test_initial_state import NAMED, PLACES, STRING, TURN, observed, released

from stringcast.stages.diagnose.prepared import lacking
from stringcast.stages.inference.evidence import evaluated, lacked
from stringcast.stages.inference.forward import MODES, case
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import about, with_change
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import chi_of

NOISE = 7e-4  # [m]


@pytest.fixture(scope="module")
def trial(arm, camera):
    """A string let go, seen at eleven places."""
    t, seen = released(TURN, PLACES["eleven"], 200, NOISE)
    return case(Model(STRING, arm, camera), observed(t, seen, PLACES["eleven"], moving=True))


@pytest.fixture(scope="module")
def hypothesis(trial):
    return Hypothesis(trial.model)


@pytest.fixture(scope="module")
def true(hypothesis):
    return chi_of(hypothesis.parameters, hypothesis.model.values(NAMED)[None])[0]


def begun(trial, *off):
    """The trial in another state: its first modes off by so much."""
    return with_change(trial, np.pad(np.array(off), (0, 2 * MODES - len(off))))


def test_a_state_far_off_is_found_from_how_the_string_moves(trial, hypothesis, true):
    """Modes about it cannot tell what it does; about the one that is found, what is left is noise. It counts from what
    the first frames say, wherever it was looked for."""
    far, told = (lacking([each], hypothesis, true) for each in (begun(trial, 4.0, -3.0, 2.0), trial))
    off = evaluated(far, hypothesis, true)
    near, found = (about(about(data, off), off) for data in (far, told))
    here, there = (evaluated(data, hypothesis, true) for data in (near, found))
    assert far.tip_rms(lacked(far, off))[0] > 5 * NOISE
    assert near.tip_rms(lacked(near, here))[0] < NOISE
    assert here.evidence > off.evidence + 100
    assert here.evidence == pytest.approx(there.evidence, abs=0.5)
    assert near.trials[0].change == pytest.approx(found.trials[0].change, abs=0.05)


def test_what_begins_at_rest_stays_as_it_is(trial, hypothesis, true):
    data = lacking([replace(trial, initial=None)], hypothesis, true)
    assert about(data, evaluated(data, hypothesis, true)) is data
