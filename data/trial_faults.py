"""Reasons why a trial of a dataset cannot be used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from stringcast.data.artifacts import FRAMES, POINTS, Film, Observation
from stringcast.data.metadata import DATASET_FILE
from stringcast.data.rows import RowCounts
from stringcast.data.schema import Table
from stringcast.data.table_files import TRIAL_COLUMN

UNIX_TIME_RANGE_S = (1e9, 4e9)  # [s]: 2001 to 2096
MIN_OVERLAP_S = 0.1  # [s] of common time of arm and camera
MIN_FRAMES = 3  # frames with the string


@dataclass(frozen=True)
class TrialFault:
    """The reason why a trial cannot be used.

    file: dataset.yaml or the name of a table. field: key or column in it.
    """

    reason: str
    remedy: str
    file: str
    field: str


def find_timeless_fault(
    name: str, row_counts: Mapping[str, RowCounts]
) -> TrialFault | None:
    """Find tables with times that are not those of single rows; None without any.

    row_counts: counts of the tables by file.
    """
    for file, counts in row_counts.items():
        if name in counts.timeless:
            return TrialFault(
                counts.timeless[name],
                "They may be stored as float32, or rounded: write them with more "
                "digits, or give the rate of the rows: import --fps 200",
                file.rpartition(".")[0],
                "t",
            )
    return None


def find_fault(
    trial: Observation,
    film: Film | None,
    hand: Table,
    block: Mapping[str, Any],
    start: float,
) -> TrialFault | None:
    """Find the reason why a trial cannot be used; None if it can.

    hand: schema of its motion. block: its entry in dataset.yaml. start: offset
    subtracted from its times [s].
    """
    if block.get("invalid"):
        return TrialFault(
            str(block["invalid"]),
            f"Take 'invalid' out of {DATASET_FILE} if it should count",
            DATASET_FILE,
            f"trials.{trial.trial}.invalid",
        )
    motion = getattr(trial, hand.name)["t"].to_numpy()
    if not len(motion):
        return TrialFault(
            "no motion of the hand",
            "Add its rows to the arm's or the grasp's table, "
            "or use the same name in both",
            hand.name,
            TRIAL_COLUMN.name,
        )
    seen = np.unique(trial.valid_points["t"])
    if len(seen):
        return _find_clock_fault(motion, seen, POINTS.name, start)
    if film is not None:
        return _find_clock_fault(motion, film.t, FRAMES.name, start)
    if trial.points.empty:
        return TrialFault(
            "no measured point and no frame",
            "Add its rows to points or frames, or use the same name in both",
            POINTS.name,
            TRIAL_COLUMN.name,
        )
    return TrialFault(
        "no measured point is valid",
        "Look at 'valid' in its points: a blank is false",
        POINTS.name,
        "valid",
    )


def _find_clock_fault(
    motion: np.ndarray, seen: np.ndarray, table: str, start: float
) -> TrialFault | None:
    """Find the reason why the times of a trial cannot be used; None if they can.

    `motion` (K,) and `seen` (F,) are times of the hand and of the string [s], less
    `start`; `table` names that with `seen`.
    """
    if len(seen) < MIN_FRAMES:
        reason = f"the string was seen in {len(seen)} frame(s) only"
        remedy = "A motion takes more frames: record it again"
        return TrialFault(reason, remedy, table, "t")
    overlap = min(motion.max(), seen.max()) - max(motion.min(), seen.min())
    if overlap >= MIN_OVERLAP_S:
        return None
    return TrialFault(
        f"arm and camera overlap for {max(overlap, 0):.2f} s only: the arm's clock "
        f"{_clock_words(motion + start)}, the camera's {_clock_words(seen + start)}",
        "See that both clocks begin together and that both count seconds; "
        "`import` lays them over one another",
        table,
        "t",
    )


def _clock_words(t: np.ndarray) -> str:
    """Describe the clock of times t (K,) [s]."""
    first = t.min()
    if UNIX_TIME_RANGE_S[0] < first < UNIX_TIME_RANGE_S[1]:
        date = datetime.fromtimestamp(first, UTC)
        return f"says {date:%Y-%m-%d %H:%M:%S} (seconds since 1970)"
    return f"goes from {first:.2f} to {t.max():.2f} s"
