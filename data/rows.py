"""Rows of measured tables: read from CSV, and cleaned so that what cannot be used is
counted, with the reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.artifacts import ARM, GRASP
from stringcast.data.file_checks import check_csv
from stringcast.data.schema import DataError, Table

# a metre in nanometres: nothing measured is further off, in whichever unit it was
# written
MAX_VALUE = 1e9
MAX_TIME_S = 1e19  # [s], or nanoseconds since 1970, of which there are 2e18
# [m], of a coordinate: nothing measures a string to an atom, and its square is still
# far from nought
MIN_SIGMA_M = 1e-9
ARC_LENGTH_ROUNDING_M = 1e-6  # [m] below which an arc length under zero is one
MOTION_TABLES = (ARM.name, GRASP.name)
MIN_SPIKE = 2e-3  # [m] or [rad] by which a sample must be off
SPIKE_RATIO = 10.0  # times as much as is usual about it
SPIKE_WINDOW_SAMPLES = 11  # samples
# of a spike, by which its neighbours must seem off the other way: of a real motion they
# are not
MIN_RETURN_FRACTION = 0.25


@dataclass(frozen=True)
class RowCounts:
    """The count of a file's rows.

    read: all of them. dropped: unusable ones by reason. unordered: rows earlier than
    the row before them of the same trial (and arc length).
    """

    total: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    unordered: int = 0


def read_csv_table(table: Table, path: Path) -> pd.DataFrame:
    """A table from CSV; raises DataError naming the file, the column and the remedy.

    What is no number in a column of numbers is NaN, unless nothing in it is one. Names
    keep their leading zeros.
    """
    texts = [column.name for column in table.columns if column.kind == "text"]
    try:
        names = pd.read_csv(check_csv(path), nrows=0).columns
        kinds = {name: str for name in names if name.strip() in texts}
        # lines may end with a comma
        frame = pd.read_csv(path, dtype=kinds, skipinitialspace=True, index_col=False)
    except (ValueError, OSError) as error:
        raise DataError(
            f"{path}: cannot be read as CSV ({error}). Save it as plain text, UTF-8, with commas."
        ) from error
    frame.columns = frame.columns.str.strip()
    if len(frame.columns) == 1 and len(table.columns) > 1:
        raise DataError(
            f"{path}: it has one column, {frame.columns[0]!r}. Separate columns by commas, with points in decimals."
        )
    for column in table.columns:
        if column.kind == "float" and column.name in frame:
            numbers = pd.to_numeric(frame[column.name], errors="coerce")
            if numbers.notna().any():
                frame[column.name] = numbers
    return table.check(frame, str(path))


class RowFilter:
    """Takes rows out of a table and counts them by reason."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame = frame
        self.dropped: dict[str, int] = {}

    def drop(self, reason: str, bad: pd.Series) -> None:
        """Take out the rows of the present frame where `bad` is true."""
        if bad.any():
            self.dropped[reason] = int(bad.sum())
            self.frame = self.frame[~bad]


def clean_rows(table: Table, frame: pd.DataFrame) -> tuple[pd.DataFrame, RowCounts]:
    """Rows that can be used, in the order of trial and time, and what became of the
    others.

    table: with the leading column `trial`. frame: of that table, as it was read.
    """
    kept = RowFilter(frame)
    for column in table.columns:
        if column.kind == "text":
            kept.drop(f"no {column.name}", kept.frame[column.name].isna())
    numbers = [c.name for c in table.columns if c.kind == "float" and not c.optional]
    for name in numbers:
        kept.drop(f"{name} is not a finite number", ~np.isfinite(kept.frame[name]))
        most = MAX_TIME_S if name == "t" else MAX_VALUE
        kept.drop(f"{name} is beyond {most:.0e}", kept.frame[name].abs() > most)
    if "s" in numbers:
        kept.drop("s is below 0", kept.frame["s"] < -ARC_LENGTH_ROUNDING_M)
    if "sigma" in kept.frame:
        kept.drop(
            "sigma is not a number above 0",
            ~(np.isfinite(kept.frame["sigma"]) & (kept.frame["sigma"] > 0)),
        )
        kept.drop(
            f"sigma is below {MIN_SIGMA_M:.0e} m", kept.frame["sigma"] < MIN_SIGMA_M
        )
    keys = [name for name in ("trial", "t", "s") if name in kept.frame]
    kept.drop("a row twice", kept.frame.duplicated())
    kept.drop(
        f"another value at the same {', '.join(keys)}; the first is kept",
        kept.frame.duplicated(keys),
    )
    kept.frame = kept.frame.assign(trial=kept.frame["trial"].map(str))
    # points may be listed place by place
    series = [name for name in ("trial", "s") if name in kept.frame]
    unordered = int((kept.frame.groupby(series)["t"].diff() < 0).sum())
    kept.frame = kept.frame.sort_values(["trial", "t"], kind="stable")
    if table.name in MOTION_TABLES:
        jumps = pd.Series(False, index=kept.frame.index)
        for _, rows in kept.frame.groupby("trial", sort=False):
            values = np.unwrap(
                rows[[name for name in numbers if name != "t"]].to_numpy(), axis=0
            )
            jumps[rows.index] = spike_mask(rows["t"].to_numpy(), values)
        kept.drop("the hand jumps away and back within two samples", jumps)
    return kept.frame, RowCounts(len(frame), kept.dropped, unordered)


def spike_mask(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Whether each sample is an outlier, (K,) bool. t: (K,) increasing times [s].
    values: (K, J), continuous.
    """
    found = np.zeros(len(t), dtype=bool)
    if len(t) < 5:  # a sample is held against two on each side
        return found
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off = values[1:-1] - values[:-2] - share[:, None] * (values[2:] - values[:-2])
    usual = (
        pd.DataFrame(np.abs(off))
        .rolling(SPIKE_WINDOW_SAMPLES, center=True, min_periods=1)
        .median()
        .to_numpy()[1:-1]
    )
    here, before, after = off[1:-1], off[:-2], off[2:]
    back = (before * here < -MIN_RETURN_FRACTION * here**2) & (
        after * here < -MIN_RETURN_FRACTION * here**2
    )
    found[2:-2] = (
        back & (np.abs(here) > np.maximum(MIN_SPIKE, SPIKE_RATIO * usual))
    ).any(axis=1)
    return found
