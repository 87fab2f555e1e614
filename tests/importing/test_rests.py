"""Recordings of a session, in which hand and string rest between motions."""

import numpy as np
import pandas as pd
import pytest

from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import gather_tables
from stringcast.data.importers.reader import ColumnHints
from stringcast.data.importers.rests import offset_of_motions
from stringcast.data.schema import DataError

CLOCK_S = 4711.0  # of the tracker behind that of the arm
CAST_S = np.array([1.0, 6.0, 13.0])  # times of casts
RETURN_S = np.array([3.2, 9.5, 17.1])  # times at which the arm returns
MOTIONS_S = np.sort([*CAST_S, *RETURN_S])
MOTION_S = 1.0  # of a cast or return
LAG_S = 0.2  # of the string
END_S = 20.0
NOTE = "hand and string rest between the motions of trial t00, which is read as"


def times(rate, end=END_S):
    return np.arange(0, end, 1 / rate)


def move(t, starts):
    """Return an angle that is raised and lowered in turn from given times on [rad]."""
    raised = np.zeros(len(t))
    for number, start in enumerate(starts):
        raised += (-1) ** number * np.clip((t - start) / MOTION_S, 0, 1)
    return raised


def record_hand(starts=MOTIONS_S, end=END_S):
    t = times(250, end)
    noise = np.random.default_rng(0).normal(0, 2e-4, len(t))
    joint = move(t, starts) + noise
    return pd.DataFrame({"t": t + CLOCK_S, "q1": joint, "q2": 0.0, "q3": 0.0})


def record_tip(starts=MOTIONS_S, swing_m=0.0, end=END_S):
    t = times(100, end)
    noise = np.random.default_rng(1).normal(0, 7e-4, len(t))
    x = 0.4 * move(t - LAG_S, starts) + noise
    return pd.DataFrame(
        {"t": t, "tip_x_m": x + swing_m * np.sin(7 * t), "tip_y_m": -0.3}
    )


def near_casts(tip, starts):
    """Keep what a tracker records that is started by hand for each cast."""
    return [tip[tip["t"].between(start - 0.3, start + 2.0)] for start in starts]


def import_session(folder, hand, tips):
    """Import a log of the arm and tables of a tracker."""
    hand.to_csv(folder / "robot.csv", index=False)
    files = [folder / "robot.csv"]
    for number, tip in enumerate(tips, 1):
        files.append(folder / f"tracker_{number}.csv")
        tip.to_csv(files[-1], index=False)
    return gather_tables(read_recordings(files), ColumnHints())


def assert_motions(tables, starts):
    """Compare the trials with motions: each begins at rest and is seen to its end."""
    assert tables.motion["trial"].nunique() == len(starts)
    by_trial = zip(
        starts,
        tables.motion.groupby("trial"),
        tables.points.groupby("trial"),
        strict=True,
    )
    for start, (name, hand), (points_name, points) in by_trial:
        assert name == points_name
        hand_t, points_t = hand["t"] - CLOCK_S, points["t"]
        assert start - 1.6 < hand_t.min() < start - 0.2
        assert start - 0.7 < points_t.min() < start
        assert start + MOTION_S + LAG_S < points_t.max() < hand_t.max() + 0.4
        assert hand_t.max() < start + 6.5


def test_motions_of_a_session_are_trials(tmp_path):
    tables = import_session(tmp_path, record_hand(), [record_tip()])
    assert f"{NOTE} 6 trials, without long rests" in tables.notes
    assert_motions(tables, MOTIONS_S)


@pytest.mark.parametrize("in_one_file", [True, False])
def test_casts_seen_by_a_pausing_tracker_are_trials(tmp_path, in_one_file):
    """The arm's log goes on, also while it returns unseen."""
    seen = near_casts(record_tip(), CAST_S)
    tips = [pd.concat(seen)] if in_one_file else seen
    tables = import_session(tmp_path, record_hand(), tips)
    assert_motions(tables, CAST_S)


def test_casts_logged_by_a_pausing_arm_are_trials(tmp_path):
    hand = record_hand()
    logged = [
        hand[hand["t"].between(CLOCK_S + start - 0.6, CLOCK_S + start + 2.2)]
        for start in CAST_S
    ]
    tables = import_session(tmp_path, pd.concat(logged), [record_tip()])
    assert_motions(tables, CAST_S)


def test_a_string_that_never_rests_is_not_cut(tmp_path):
    tip = record_tip(swing_m=0.05)
    tables = import_session(tmp_path, record_hand(), [tip])
    assert set(tables.motion["trial"]) == {"t00"}
    assert not tables.notes


def test_files_are_not_paired_by_guess_if_motions_are_alike(tmp_path):
    """Two recorded motions of four equal ones at equal intervals may be any two."""
    starts = 1.0 + 5.0 * np.arange(4)
    hand, tip = record_hand(starts), record_tip(starts)
    seen = near_casts(tip, starts[1:3])
    with pytest.raises(DataError, match="The hand was recorded in the trials t00"):
        import_session(tmp_path, hand, seen)
    tables = import_session(tmp_path, hand, [pd.concat(seen)])
    assert set(tables.motion["trial"]) == {"t00"}
    assert not tables.notes
    same_clock = hand.assign(t=hand["t"] - CLOCK_S)
    tables = import_session(tmp_path, same_clock, seen)
    assert tables.motion["trial"].nunique() == 2


def test_two_motions_do_not_show_the_offset_of_clocks(tmp_path):
    """One interval between motions may occur by chance at a wrong offset."""
    tip = record_tip()
    seen = near_casts(tip, CAST_S[:2])
    with pytest.raises(DataError, match="The hand was recorded in the trials t00"):
        import_session(tmp_path, record_hand(), seen)


def test_motions_of_a_long_session_show_the_offset_of_clocks():
    """A day of casts has too many pairs of motions to compare all with all."""
    hand_t = np.cumsum(np.random.default_rng(0).uniform(3.0, 9.0, 1500))
    string_t = hand_t[::2] + LAG_S - CLOCK_S
    assert offset_of_motions(hand_t, string_t) == pytest.approx(CLOCK_S - LAG_S)
