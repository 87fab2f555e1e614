"""Alignment of the clocks of arm and camera by the motion.

It uses all of a string, or its tip alone.
"""

from dataclasses import replace

import pytest
from conftest import ROOT

from stringcast.pipeline.commands.check import read_measurements
from stringcast.stages.check.time_shifts import estimate_time_shifts

TRIALS = read_measurements(ROOT / "data" / "sample", []).trials


def late(seen, by, tip_alone):
    points = (
        seen.points.groupby("t").tail(1)
        if tip_alone
        else seen.points[seen.points["s"] > 0.2]
    )
    return replace(
        seen,
        observation=replace(seen.observation, points=points.assign(t=points["t"] + by)),
    )


@pytest.mark.parametrize("tip_alone", [True, False])
def test_a_shift_of_all_trials_is_found_to_a_frame(tip_alone):
    found = estimate_time_shifts([late(seen, 12.345, tip_alone) for seen in TRIALS])
    assert set(found) == {seen.name for seen in TRIALS}
    # the tolerance [s] is one frame
    assert all(shift == pytest.approx(-12.345, abs=0.005) for shift in found.values())


def test_each_trial_may_have_a_shift_of_its_own():
    given = {"t00": 3.0, "t03": -5.0}
    found = estimate_time_shifts(
        [late(seen, given[seen.name], True) for seen in TRIALS if seen.name in given]
    )
    assert {name: round(shift) for name, shift in found.items()} == {
        "t00": -3,
        "t03": 5,
    }


@pytest.mark.parametrize("tip_alone", [True, False])
def test_clocks_that_begin_anew_with_each_trial_are_laid_to_a_frame_but_where_the_string_hangs_slack(
    tip_alone,
):
    """Clocks that restart with each trial are aligned to a frame for a taut string.

    In t01 the hand moves towards the tip at first, so that for 25 ms nothing shows that
    it is late.
    """
    own = {seen.name: -10.0 * number for number, seen in enumerate(TRIALS)}
    found = estimate_time_shifts(
        [late(seen, own[seen.name], tip_alone) for seen in TRIALS]
    )
    off = {name: shift + own[name] for name, shift in found.items()}
    assert off.pop("t01") < 0.025
    assert max(map(abs, off.values())) < 0.005
