"""Held-out trials are searched if they misfit and the others do not."""

import json

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import diagnose_trials, simulate_trial, swing_angles

from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.model.library import effects_by_name

S = np.linspace(0.03, 0.3, 10)
OFFSET_S = 0.01


def simulate_with_offset(arm, offset_s):
    """Yield three trials in which the arm hardly moves, and one with a swing."""
    model = with_second_order_mesh(ordinary(arm))
    model = model.with_effects(effects_by_name()["time_offset"]).with_segments(80)
    values = TRUTH | {"time_offset.offset": offset_s}
    rng = np.random.default_rng(3)
    places = np.rint(S / model.string.segment_length).astype(int)
    for k, swing in enumerate(swing_angles(arm, 4)):
        angles = swing if k == 3 else swing[:1] + 0.02 * (swing - swing[:1])
        yield simulate_trial(f"t{k}", arm, model, values, angles, places, rng)


@pytest.mark.long
def test_a_cause_in_a_held_out_trial_only_is_found(arm):
    """`test_forward_selection` has a held-out trial without such a misfit."""
    trials = list(simulate_with_offset(arm, OFFSET_S))
    diagnosis = diagnose_trials(ordinary(arm), trials, 4, held_out=["t3"])
    document = json.loads(diagnosis.finding["diagnosis"].iloc[0])
    names = {cause["effect"] for cause in document["causes"]}
    assert document["gain"]["held_out_trials"] == ["t0", "t1", "t2", "t3"]
    assert document["gain"]["causes_chosen_from_them"]
    assert "time_offset" in names, document["verdict"]
