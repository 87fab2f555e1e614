"""Trials of recordings that pause: one file of the hand and one of the string."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.importers.reader import ONLY_TRIAL, trial_name
from stringcast.data.importers.times import typical_step

MIN_PAUSE_S = 0.5
MIN_PAUSE_STEPS = 20.0  # usual steps between samples


def split_at_pauses(
    motion: pd.DataFrame, points: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame, list[str]]:
    """Split each trial where the recordings of hand and string both pause.

    They must pause equally often, because their clocks may differ. A pause of one alone
    is lost data. Returns both tables with new names of trials, and notes.
    """
    motion = motion.copy()
    points = points.copy()
    notes = []
    for name in motion["trial"].unique():
        hand_rows = motion["trial"] == name
        point_rows = points["trial"] == name
        hand_parts = number_parts(motion.loc[hand_rows, "t"])
        point_parts = number_parts(points.loc[point_rows, "t"])
        count = 1 + hand_parts.max(initial=0)
        if count == 1 or count != 1 + point_parts.max(initial=0):
            continue
        names = np.array([part_name(name, number) for number in range(count)])
        motion.loc[hand_rows, "trial"] = names[hand_parts]
        points.loc[point_rows, "trial"] = names[point_parts]
        often = "once" if count == 2 else f"{count - 1} times"
        notes.append(
            f"the recordings of trial {name} pause {often}, and are read as "
            f"{count} trials"
        )
    return motion, points, notes


def number_parts(times: pd.Series) -> np.ndarray:
    """Return the number of the part of each time, (K,) from 0; pauses divide parts."""
    measured = times[np.isfinite(times)]
    min_pause = max(MIN_PAUSE_S, MIN_PAUSE_STEPS * typical_step(measured))
    distinct = np.unique(measured)
    starts = distinct[1:][np.diff(distinct) > min_pause]
    return np.searchsorted(starts, times, side="right")


def part_name(trial: str, number: int) -> str:
    """Name a part of a trial; the recordings of one pair of files are all trials."""
    if trial == ONLY_TRIAL:
        return trial_name(f"{number + 1:02d}")
    return f"{trial}_{number + 1}"
