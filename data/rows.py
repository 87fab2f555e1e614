"""Rows of measured tables: read from CSV, and cleaned of rows that cannot be used.

Dropped rows are counted by reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.artifacts import ARM, GRASP
from stringcast.data.file_checks import check_csv, read_frame, text_options
from stringcast.data.schema import DataError, Table

MAX_VALUE = 1e9  # a metre in nanometres: no measured distance is larger in any unit
MAX_TIME_S = 1e19  # [s], or nanoseconds since 1970, of which there are 2e18
# [m] of a coordinate: an atom's size, and its square is far from zero
MIN_SIGMA_M = 1e-9
ARC_LENGTH_ROUNDING_M = 1e-6  # [m] below zero that an arc length may be by rounding
MOTION_TABLES = (ARM.name, GRASP.name)
MIN_SPIKE = 2e-3  # [m] or [rad] by which a spike exceeds its neighbours
SPIKE_RATIO = 10.0  # ratio of a spike to the median deviation around it
SPIKE_WINDOW_SAMPLES = 11  # samples of that median
# Fraction of a spike by which its neighbours seem off the other way, as they do not in
# a real motion.
MIN_RETURN_FRACTION = 0.25


@dataclass(frozen=True)
class RowCounts:
    """Counts of a file's rows.

    total: rows in the file. dropped: unusable ones by reason. unordered: rows earlier
    than the row before them of the same trial (and arc length).
    """

    total: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    unordered: int = 0


def read_csv_table(table: Table, path: Path) -> pd.DataFrame:
    """Read a table from CSV.

    A text in a column of numbers becomes NaN, unless the column holds no number at all.
    Names keep their leading zeros.

    Parameters
    ----------
    table
        The schema that the file must fit.
    path
        The file.

    Returns
    -------
    pandas.DataFrame
        The table with the declared types.

    Raises
    ------
    DataError
        If the file does not fit; it names the file, the column and the remedy.
    """
    remedy = "Save it as plain text, UTF-8, with commas."
    names = read_frame(check_csv(path), "CSV", remedy, nrows=0).columns
    texts = {column.name for column in table.columns if column.kind == "text"}
    names_of_texts = [name for name in names if name.strip() in texts]
    frame = read_frame(
        path,
        "CSV",
        remedy,
        skipinitialspace=True,
        index_col=False,  # lines may end with a comma
        **text_options(names, names_of_texts),
    )
    frame.columns = frame.columns.str.strip()
    if len(frame.columns) == 1 and len(table.columns) > 1:
        raise DataError(
            f"{path}: it has one column, {frame.columns[0]!r}. "
            "Separate columns by commas, with points in decimals."
        )
    for column in table.columns:
        if column.kind == "float" and column.name in frame:
            numbers = pd.to_numeric(frame[column.name], errors="coerce")
            if numbers.notna().any():
                frame[column.name] = numbers
    return table.check(frame, str(path))


class RowFilter:
    """A table from which rows are dropped and counted by reason."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame = frame
        self.dropped: dict[str, int] = {}

    def drop(self, reason: str, is_bad: pd.Series) -> None:
        """Drop the rows of the present frame where `is_bad` is true."""
        if is_bad.any():
            self.dropped[reason] = int(is_bad.sum())
            self.frame = self.frame[~is_bad]


def clean_rows(table: Table, frame: pd.DataFrame) -> tuple[pd.DataFrame, RowCounts]:
    """Drop unusable rows and sort the others by trial and time.

    Parameters
    ----------
    table
        The schema, with the leading column `trial`.
    frame
        The table as it was read.

    Returns
    -------
    frame : pandas.DataFrame
        The usable rows.
    counts : Rows
        How many rows were read and dropped.
    """
    rows = RowFilter(frame)
    numbers = []
    for column in table.columns:
        if column.kind == "text" and not column.optional:
            rows.drop(f"no {column.name}", rows.frame[column.name].isna())
        elif column.kind == "float" and not column.optional:
            numbers.append(column.name)
    for name in numbers:
        rows.drop(f"{name} is not a finite number", ~np.isfinite(rows.frame[name]))
        most = MAX_TIME_S if name == "t" else MAX_VALUE
        rows.drop(f"{name} is beyond {most:.0e}", rows.frame[name].abs() > most)
    if "s" in numbers:
        rows.drop("s is below 0", rows.frame["s"] < -ARC_LENGTH_ROUNDING_M)
    if "sigma" in rows.frame:
        sigma = rows.frame["sigma"]
        rows.drop("sigma is not a number above 0", ~(np.isfinite(sigma) & (sigma > 0)))
        rows.drop(
            f"sigma is below {MIN_SIGMA_M:.0e} m", rows.frame["sigma"] < MIN_SIGMA_M
        )
    keys = [name for name in ("trial", "t", "s") if name in rows.frame]
    rows.drop("a row twice", rows.frame.duplicated())
    reason = f"another value at the same {', '.join(keys)}; the first is kept"
    rows.drop(reason, rows.frame.duplicated(keys))

    usable = rows.frame.assign(trial=rows.frame["trial"].map(str))
    series = [name for name in keys if name != "t"]  # points may be listed by place
    unordered = int((usable.groupby(series)["t"].diff() < 0).sum())
    rows.frame = usable.sort_values(["trial", "t"], kind="stable")
    if table.name in MOTION_TABLES:
        numbers.remove("t")
        is_spike = pd.Series(False, index=rows.frame.index)
        for _, trial in rows.frame.groupby("trial", sort=False):
            values = np.unwrap(trial[numbers].to_numpy(), axis=0)
            is_spike[trial.index] = spike_mask(trial["t"].to_numpy(), values)
        rows.drop("the hand jumps away and back within two samples", is_spike)
    return rows.frame, RowCounts(len(frame), rows.dropped, unordered)


def spike_mask(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Find single samples that jump away and back.

    Parameters
    ----------
    t : (K,)
        Increasing times [s].
    values : (K, J)
        Continuous values of the samples.

    Returns
    -------
    (K,) bool
        True for a spike.
    """
    is_spike = np.zeros(len(t), dtype=bool)
    if len(t) < 5:  # a sample is compared with two on each side
        return is_spike
    # distance of each sample from the line between its neighbours
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    offset = values[1:-1] - values[:-2] - share[:, None] * (values[2:] - values[:-2])
    window = pd.DataFrame(np.abs(offset)).rolling(
        SPIKE_WINDOW_SAMPLES, center=True, min_periods=1
    )
    typical = window.median().to_numpy()[1:-1]
    before, middle, after = offset[:-2], offset[1:-1], offset[2:]
    opposite = -MIN_RETURN_FRACTION * middle**2
    returns = (before * middle < opposite) & (after * middle < opposite)
    is_large = np.abs(middle) > np.maximum(MIN_SPIKE, SPIKE_RATIO * typical)
    is_spike[2:-2] = (returns & is_large).any(axis=1)
    return is_spike
