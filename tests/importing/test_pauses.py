"""Recordings that hold several trials with pauses between them."""

import numpy as np
import pandas as pd
import pytest

from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import gather_tables
from stringcast.data.importers.reader import ColumnHints

CLOCK_S = 4711.0  # of the tracker behind that of the arm
PAUSES = "the recordings of trial t00 pause 2 times, and are read as 3 trials"


def record_times(starts, duration, rate):
    """Return times [s] of recordings of equal duration."""
    parts = [start + np.arange(0, duration, 1 / rate) for start in starts]
    return np.concatenate(parts)


def import_times(folder, hand_t, point_t):
    """Import a log of the arm and a table of a tracker with these times [s]."""
    hand = {"t": hand_t, "q1": 1 + 0 * hand_t, "q2": 0.0, "q3": 0.0}
    tip = {"t": point_t, "tip_x_m": 0.2 + 0 * point_t, "tip_y_m": -0.3}
    files = [folder / "robot.csv", folder / "tracker.csv"]
    for file, columns in zip(files, (hand, tip), strict=True):
        pd.DataFrame(columns).to_csv(file, index=False)
    return gather_tables(read_recordings(files), ColumnHints())


def test_recordings_that_pause_together_are_trials(tmp_path):
    starts = np.array([0.0, 3.0, 9.0])
    hand_t = CLOCK_S + record_times(starts, duration=1.0, rate=250)
    point_t = record_times(starts + 0.1, duration=0.8, rate=100)
    tables = import_times(tmp_path, hand_t, point_t)
    assert PAUSES in tables.notes
    for table, clock, start, rows in (
        (tables.motion, CLOCK_S, starts, 250),
        (tables.points, 0.0, starts + 0.1, 80),
    ):
        begins = table.groupby("trial")["t"].min()
        assert list(begins.index) == ["t01", "t02", "t03"]
        assert begins.to_numpy() - clock == pytest.approx(start, abs=1e-6)
        assert (table.groupby("trial").size() == rows).all()


@pytest.mark.parametrize("lost", ["hand", "points", "little of both"])
def test_lost_samples_do_not_split_a_trial(tmp_path, lost):
    complete = record_times([0.0], duration=3.0, rate=100)
    gap_s = 0.3 if lost == "little of both" else 1.0
    remaining = complete[(complete < 1.0) | (complete > 1.0 + gap_s)]
    hand_t = complete if lost == "points" else remaining
    point_t = complete if lost == "hand" else remaining
    tables = import_times(tmp_path, hand_t, point_t)
    assert set(tables.motion["trial"]) == set(tables.points["trial"]) == {"t00"}
    assert not tables.notes
