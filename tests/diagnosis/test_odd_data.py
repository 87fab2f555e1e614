"""Data that are allowed and seldom: a trial that says nothing, one that begins moving,
and numbers that do not exist.
"""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary

from stringcast.data.artifacts import HELD_OUT, JOINTS, MASKS, READINGS, Observation
from stringcast.stages.diagnose.document import (
    gain_document,
    replace_non_finite,
    widened_ranges,
)
from stringcast.stages.diagnose.predictions import (
    RATED_FRAMES,
    matching_rate,
    thin_frames,
)
from stringcast.stages.diagnose.preparation import usable_trials
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.generate.curves import Curves
from stringcast.stages.inference.prepared_trial import prepare_trial

S = np.array([0.1, 0.2, 0.3])
FINE = Matching(dilations=20, step_px=1, tip_step_px=1.0, delta_w=0.25)


@pytest.fixture(scope="module")
def model(arm):
    return ordinary(arm)


@pytest.fixture(scope="module")
def begun(arm, model):
    """A swing of which the camera missed the first fifth of a second."""
    control = np.zeros((1, 3, 6))
    control[0, :, 1:-1] = 3 * np.array(
        [[1.0, 0.6, -0.4, -1.0], [0.5, 0.9, 0.2, -0.8], [0.3] * 4]
    )
    angles = Curves(np.array([[0.3, 0.5, 0.2]]), np.array([0.5]), control).sample(
        arm.tick, 0.5
    )[0][0]
    t = arm.tick * np.arange(len(angles))
    joints = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
    whole = Observation("t0", pd.DataFrame(), READINGS.empty(), MASKS.empty(), joints)
    motion = prepare_trial(
        model, replace(whole, points=at(t, np.zeros((len(t), len(S), 2))))
    ).motion
    seen = model.simulate_observation(motion, model.values(TRUTH)[None], t).points[0]
    places = np.searchsorted(model.string.arc_lengths(), S - 1e-9)
    return replace(
        whole, points=at(t, seen[:, places]).query("t > 0.2"), starts_moving=True
    )


def at(t, points):
    """Points (F, S, 2) as a table."""
    x, y = points.reshape(-1, 2).T
    return pd.DataFrame(
        {
            "t": np.repeat(t, len(S)),
            "s": np.tile(S, len(t)),
            "x": x,
            "y": y,
            "sigma": 1e-3,
        }
    )


def test_a_trial_that_says_nothing_is_left_out_with_the_reason(model, begun):
    """And does not keep the others from being diagnosed."""
    unread = replace(begun, trial="t1", points=begun.points.assign(valid=False))
    short = replace(begun, trial="t2", points=begun.points[begun.points["t"] < 0.211])
    good, faults = usable_trials(model, [begun, unread, short])
    assert [o.trial for o in good] == ["t0"]
    assert "no valid point" in faults["t1"]
    assert "begins moving" in faults["t2"]
    assert not any(reason.startswith("trial") for reason in faults.values())


def test_the_matching_rate_is_that_of_the_state_in_which_the_trial_begins(model, begun):
    """Some twenty frames of a trial are too far apart to tell it from."""
    ready, chi = (
        prepare_trial(model, begun),
        np.array([float(p.chi(np.asarray(TRUTH[p.name]))) for p in model.parameters]),
    )
    assert RATED_FRAMES <= thin_frames(begun).points["t"].nunique() < 2 * RATED_FRAMES
    right = matching_rate(model, chi, ready, begun, FINE)
    elsewhere = replace(
        ready,
        initial_state=replace(
            ready.initial_state, angle=ready.initial_state.angle + 0.5
        ),
    )
    assert right > 0.8  # measured: 0.825, and 0.25 elsewhere
    assert matching_rate(model, chi, elsewhere, begun, FINE) < right - 0.3


def rows(**other):
    numbers = {c.name: [0.003, 0.004] for c in HELD_OUT.columns if c.kind == "float"}
    return HELD_OUT.check(pd.DataFrame({"trial": ["t0", "t1"]} | numbers | other))


def test_the_gain_has_all_that_the_format_says_even_where_nothing_is_known():
    whole, nothing = (
        replace_non_finite(gain_document(table)) for table in (rows(), HELD_OUT.empty())
    )
    assert {
        name: set(block) for name, block in whole.items() if isinstance(block, dict)
    } == {
        "rms_m": {"base", "extended", "noise_floor"},
        "tip_rms_m": {"base", "extended"},
        "matching_rate": {"base", "extended"},
        "log_likelihood_per_trial": {"difference", "standard_error"},
    }
    assert whole["rms_m"]["base"] == pytest.approx(np.sqrt(12.5) * 1e-3)
    assert nothing["held_out_trials"] == []
    assert {name for name, block in nothing.items() if isinstance(block, dict)} == {
        *whole
    } - {"held_out_trials"}
    assert all(
        value is None
        for block in nothing.values()
        if isinstance(block, dict)
        for value in block.values()
    )


def test_the_gain_is_json_that_everybody_can_read():
    """Of one trial there is no standard error, of a run that was rejected no matching
    rate.
    """
    said = replace_non_finite(gain_document(rows(E_extended=[np.nan, np.nan])[:1]))
    json.dumps(said, allow_nan=False)
    assert said["matching_rate"] == {"base": pytest.approx(0.003), "extended": None}
    assert said["log_likelihood_per_trial"]["standard_error"] is None
    assert replace_non_finite({"a": [(1, "b", float("inf"))]}) == {
        "a": [[1, "b", None]]
    }


def test_wider_ranges_are_told_to_the_other_stages(model):
    wide = replace(model.string.parameters[2], high=1e9)
    other = replace(model.string, ranges={**model.string.ranges, wide.name: wide})
    assert widened_ranges(model.string, other) == {
        wide.name: {"low": wide.low, "high": 1e9}
    }
    assert widened_ranges(model.string, model.string) == {}
