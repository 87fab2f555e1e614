"""Trials that are set aside for measuring the gain: looked at only if they show what the others do not."""

import json

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary
from test_parts_of_a_diagnosis import SIGMA, S, resolved, swings

from data.artifacts import JOINTS, MASKS, READINGS, Observation
from stages.diagnose.casts import Design
from stages.diagnose.diagnose import diagnose
from stages.estimate.matching import Matching
from stages.model.hand import joint_motion
from stages.model.library import library

DESIGN = Design(motions=1, shortest=0.4, longest=0.8, alpha=150.0, before=0.05, after=0.1)
MATCHING = Matching(dilations=20, step_px=2, tip_step_px=3.0, delta_w=0.25)


def observed(arm, offset):
    """Three trials in which the arm hardly moves, and one in which it swings; clocks differ."""
    real = resolved(ordinary(arm)).with_effects(library()["time_offset"]).divided(80)
    values, rng = real.values(TRUTH | {"time_offset.offset": offset})[None], np.random.default_rng(3)
    places = np.rint(S / real.string.segment).astype(int)
    for k, swung in enumerate(swings(arm, 4)):
        angles = swung if k == 3 else swung[:1] + 0.02 * (swung - swung[:1])
        t = arm.tick * np.arange(len(angles))
        seen = real.seen(joint_motion(t, angles), values, t).points[0][:, places]
        x, y = (seen + SIGMA * rng.standard_normal(seen.shape)).reshape(-1, 2).T
        s = np.tile(places * real.string.segment, len(t))
        points = pd.DataFrame({"t": np.repeat(t, len(places)), "s": s, "x": x, "y": y, "sigma": SIGMA})
        log = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
        yield Observation(f"t{k}", points, READINGS.empty(), MASKS.empty(), log)


@pytest.mark.parametrize(("offset", "left_out"), [(0.01, ["t0", "t1", "t2", "t3"]), (0.0, ["t3"])])
def test_what_only_a_trial_set_aside_shows_is_found_and_said(arm, offset, left_out):
    trials = list(observed(arm, offset))
    said = diagnose(ordinary(arm), trials, {}, ["t3"], (), seed=0, starts=4, matching=MATCHING, design=DESIGN)
    document = json.loads(said.finding["diagnosis"].iloc[0])
    named, sentence = {cause["effect"] for cause in document["causes"]}, document["unexplained"]["sentence"]
    assert document["gain"]["held_out_trials"] == left_out
    assert ("time_offset" in named) == (offset > 0), document["verdict"]
    assert ("set aside for measuring the gain (t3)" in sentence) == (offset > 0)
