"""Trials that begin moving, whose initial states are re-estimated with each fit."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.test_initial_state import (
    NAMED,
    PLACES,
    STRING,
    TURN,
    observed,
    released,
)

from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import (
    with_initial_amplitudes,
    with_initial_states_at,
)
from stringcast.stages.inference.laplace import evaluate_fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import INITIAL_MODES, prepare_trial
from stringcast.stages.model.model import Model

NOISE = 7e-4  # [m]


@pytest.fixture(scope="module")
def trial(arm, camera):
    """Simulate a released string, seen at eleven places."""
    t, seen = released(TURN, PLACES["eleven"], 200, NOISE)
    return prepare_trial(
        Model(STRING, arm, camera),
        observed(t, seen, PLACES["eleven"], starts_moving=True),
    )


@pytest.fixture(scope="module")
def hypothesis(trial):
    return Hypothesis(trial.model)


@pytest.fixture(scope="module")
def true(hypothesis):
    return hypothesis.model.exponents_of_values(NAMED)


def begun(trial, *off):
    """Return the trial with another initial state.

    Its first modes differ by the given amounts.
    """
    return with_initial_amplitudes(
        trial, np.pad(np.array(off), (0, 2 * INITIAL_MODES - len(off)))
    )


def test_a_wrong_initial_state_is_corrected_from_the_motion(trial, hypothesis, true):
    """A distant initial state is found from the string's motion.

    Modes linearised at the distant state cannot explain the motion. At the state
    found, the residual is noise. Mode amplitudes are relative to the state of the first
    frames, for any start of the search.
    """
    far, measured = (
        attach_discrepancy_model([each], hypothesis, true)
        for each in (begun(trial, 4.0, -3.0, 2.0), trial)
    )
    off = evaluate_fit(far, hypothesis, true)
    near, found = (
        with_initial_states_at(with_initial_states_at(data, off), off)
        for data in (far, measured)
    )
    here, there = (evaluate_fit(data, hypothesis, true) for data in (near, found))
    assert far.tip_rms_by_trial(mean_discrepancy(far, off))[0] > 5 * NOISE
    assert near.tip_rms_by_trial(mean_discrepancy(near, here))[0] < NOISE
    assert here.log_evidence > off.log_evidence + 100
    assert here.log_evidence == pytest.approx(there.log_evidence, abs=0.5)
    # In standard deviations: modes compensate the rest
    assert near.trials[0].mode_amplitudes == pytest.approx(
        found.trials[0].mode_amplitudes, abs=0.1
    )


def test_a_trial_at_rest_is_unchanged(trial, hypothesis, true):
    data = attach_discrepancy_model(
        [replace(trial, initial_state=None)], hypothesis, true
    )
    assert with_initial_states_at(data, evaluate_fit(data, hypothesis, true)) is data
