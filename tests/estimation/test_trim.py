"""Frames after a string has touched an obstacle are excluded from estimation."""

import numpy as np
import pandas as pd

from stringcast.data.artifacts import MASKS, READINGS, Observation
from stringcast.stages.estimate.trim import CONTACT_MARGIN_M, trim_at_contact
from stringcast.stages.model.box import Box

S = np.linspace(0.1, 0.3, 5)
WALL = Box(0.5, 0.0, 0.02, 1.0)


def going_right(step, frames=20):
    """Return a hanging string that moves right by `step` [m] from frame to frame."""
    t, s = np.meshgrid(0.005 * np.arange(frames), S, indexing="ij")
    x = step * np.round(t / 0.005)
    points = pd.DataFrame(
        {"t": t.ravel(), "s": s.ravel(), "x": x.ravel(), "y": -s.ravel(), "valid": True}
    )
    return Observation("t", points, READINGS.empty(), MASKS.empty())


def last_x(observation):
    return observation.points["x"].max()


def test_a_trial_ends_before_it_touches():
    """A trial ends before the string touches the wall.

    It moves 30 mm from frame to frame: 480 mm is within 10 mm of the wall's face at 490
    mm, 450 mm is not.
    """
    assert last_x(trim_at_contact(going_right(0.03), [WALL])) == 0.03 * 15
    assert 0.49 - CONTACT_MARGIN_M <= 0.03 * 16


def test_what_passes_between_two_frames_has_touched_too():
    """A string that passes a thin wall between two frames has touched it.

    It moves 150 mm from frame to frame.
    """
    assert (
        last_x(trim_at_contact(going_right(0.15), [Box(0.525, 0.0, 0.002, 1.0)]))
        == 0.15 * 3
    )


def test_points_that_were_not_measured_touch_nothing_and_hide_nothing():
    seen = going_right(0.03)
    seen.points.loc[seen.points["s"] == S[2], "valid"] = False
    cut = trim_at_contact(seen, [WALL])
    assert last_x(cut) == 0.03 * 15
    assert len(cut.points) == 16 * len(S)


def test_without_obstacles_or_clear_of_them_or_touching_from_the_first_all_stays():
    seen = going_right(0.01)
    assert trim_at_contact(seen, []) is seen
    assert trim_at_contact(seen, [WALL]) is seen
    assert trim_at_contact(seen, [Box(0.0, 0.0, 0.02, 1.0)]) is seen


def test_a_trial_of_which_nothing_was_read_is_left_to_those_who_say_so():
    seen = going_right(0.03)
    seen.points["valid"] = False
    assert trim_at_contact(seen, [WALL]) is seen
