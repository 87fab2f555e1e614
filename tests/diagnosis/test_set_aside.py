"""Trials that are set aside for measuring the gain: looked at only if they show what
the others do not.
"""

import json

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, said_of, swings

from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.model.library import effects_by_name

S = np.linspace(0.03, 0.3, 10)


def observed(arm, offset):
    """Three trials in which the arm hardly moves, and one in which it swings; clocks
    differ.
    """
    real = (
        with_second_order_mesh(ordinary(arm))
        .with_effects(effects_by_name()["time_offset"])
        .with_segments(80)
    )
    values, rng = TRUTH | {"time_offset.offset": offset}, np.random.default_rng(3)
    places = np.rint(S / real.string.segment_length).astype(int)
    for k, swung in enumerate(swings(arm, 4)):
        angles = swung if k == 3 else swung[:1] + 0.02 * (swung - swung[:1])
        yield performed(f"t{k}", arm, real, values, angles, places, rng)


@pytest.mark.parametrize(
    ("offset", "left_out"),
    [
        pytest.param(0.01, ["t0", "t1", "t2", "t3"], marks=pytest.mark.long),
        (0.0, ["t3"]),
    ],
)
def test_what_only_a_trial_set_aside_shows_is_found(arm, offset, left_out):
    said = said_of(ordinary(arm), list(observed(arm, offset)), 4, held_out=["t3"])
    document = json.loads(said.finding["diagnosis"].iloc[0])
    named = {cause["effect"] for cause in document["causes"]}
    assert document["gain"]["held_out_trials"] == left_out
    assert document["gain"]["causes_chosen_from_them"] == (offset > 0)
    assert ("time_offset" in named) == (offset > 0), document["verdict"]
