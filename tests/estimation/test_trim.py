"""Frames after a string has touched an obstacle are excluded from estimation."""

import numpy as np
import pandas as pd

from stringcast.data.artifacts import MASKS, READINGS, Observation
from stringcast.stages.estimate.trim import CONTACT_MARGIN_M, trim_at_contact
from stringcast.stages.model.box import Box

S = np.linspace(0.1, 0.3, 5)
WALL = Box(0.5, 0.0, 0.02, 1.0)


def moving_right(step, frames=20):
    """Return a hanging string that moves right by `step` [m] from frame to frame."""
    t, s = np.meshgrid(0.005 * np.arange(frames), S, indexing="ij")
    x = step * np.round(t / 0.005)
    points = pd.DataFrame(
        {"t": t.ravel(), "s": s.ravel(), "x": x.ravel(), "y": -s.ravel(), "valid": True}
    )
    return Observation("t", points, READINGS.empty(), MASKS.empty())


def last_x(observation):
    return observation.points["x"].max()


def test_trial_is_cut_before_contact():
    """The string moves 30 mm per frame.

    480 mm is within 10 mm of the wall's face at 490 mm, and 450 mm is not.
    """
    assert last_x(trim_at_contact(moving_right(0.03), [WALL])) == 0.03 * 15
    assert 0.49 - CONTACT_MARGIN_M <= 0.03 * 16


def test_contact_between_two_frames_is_detected():
    """The string passes a thin wall, moving 150 mm per frame."""
    assert (
        last_x(trim_at_contact(moving_right(0.15), [Box(0.525, 0.0, 0.002, 1.0)]))
        == 0.15 * 3
    )


def test_invalid_points_are_ignored_in_contact_detection():
    seen = moving_right(0.03)
    seen.points.loc[seen.points["s"] == S[2], "valid"] = False
    cut = trim_at_contact(seen, [WALL])
    assert last_x(cut) == 0.03 * 15
    assert len(cut.points) == 16 * len(S)


def test_trials_without_contact_or_in_contact_from_the_start_stay_whole():
    seen = moving_right(0.01)
    assert trim_at_contact(seen, []) is seen
    assert trim_at_contact(seen, [WALL]) is seen
    assert trim_at_contact(seen, [Box(0.0, 0.0, 0.02, 1.0)]) is seen


def test_trial_without_valid_points_stays_whole():
    seen = moving_right(0.03)
    seen.points["valid"] = False
    assert trim_at_contact(seen, [WALL]) is seen
