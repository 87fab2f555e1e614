"""Reading of measured tables from CSV, and removal of unusable rows.

Dropped rows are counted by reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.artifacts import ARM, GRASP, POINTS
from stringcast.data.file_checks import check_csv, read_frame, text_options
from stringcast.data.lost_samples import LostSamples, find_lost_points, zero_row_mask
from stringcast.data.schema import DataError, Table

MAX_VALUE = 1e9  # a metre in nanometres
MAX_TIME_S = 1e19  # nanoseconds since 1970 are 2e18
# [m]: size of an atom; its square does not underflow
MIN_SIGMA_M = 1e-9
ARC_LENGTH_ROUNDING_M = 1e-6  # negative arc length accepted as rounding
MOTION_TABLES = (ARM.name, GRASP.name)
MIN_SPIKE = 2e-3  # [m] or [rad] above the neighbours
SPIKE_RATIO = 10.0  # ratio of a spike to the median deviation around it
SPIKE_WINDOW_SAMPLES = 11  # window of the median deviation
# A spike makes its neighbours deviate the other way, by at least this fraction. Real
# motion does not.
MIN_RETURN_FRACTION = 0.25
# shared times: rows per distinct time, in trials of at least so many rows
MIN_ROWS_PER_TIME = 1.5
MIN_TIMED_ROWS = 5
TURN_JUMP_RAD = 1.5 * np.pi  # larger steps between samples are wraps
MAX_WRAPPED_RANGE_RAD = 2 * np.pi + 0.01  # a turn plus rounding


@dataclass(frozen=True)
class RowCounts:
    """Counts of a file's rows.

    total: rows in the file. dropped: unusable rows by reason. columns: those with
    unusable values. unordered: rows earlier than the previous row of the same trial and
    point. lost: points written by a tracker without a detection; also dropped.
    timeless: trials whose times are not those of single rows, with the reason.
    unwrapped: trials with wrapped angles, by joint.
    """

    total: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    unordered: int = 0
    lost: tuple[LostSamples, ...] = ()
    timeless: Mapping[str, str] = field(default_factory=dict)
    unwrapped: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def missing(self) -> int:
        """Number of unused rows."""
        return sum(self.dropped.values()) + sum(one.count for one in self.lost)


def read_csv_table(table: Table, path: Path) -> pd.DataFrame:
    """Read a table from CSV, with the types that its schema declares.

    Text in a column of numbers becomes NaN if the column holds any number. Names keep
    their leading zeros. Raises DataError if the file does not fit; it names the file,
    the column and the remedy.
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
            path,
            f"it has one column, {frame.columns[0]!r}",
            "Separate columns by commas, with points in decimals.",
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
        self.columns: list[str] = []

    def drop(self, reason: str, is_bad: pd.Series, column: str = "") -> None:
        """Drop the rows of the present frame where `is_bad` is true.

        column: the one with unusable values, if it is one.
        """
        if is_bad.any():
            self.dropped[reason] = int(is_bad.sum())
            self.frame = self.frame[~is_bad]
            if column and column not in self.columns:
                self.columns.append(column)


def clean_rows(table: Table, frame: pd.DataFrame) -> tuple[pd.DataFrame, RowCounts]:
    """Drop unusable rows, count them, and sort the others by trial and time.

    table: the schema, with the leading column `trial`.
    """
    required = [column for column in table.columns if not column.optional]
    texts = [column.name for column in required if column.kind == "text"]
    numbers = [column.name for column in required if column.kind == "float"]
    rows = RowFilter(frame)
    _drop_impossible_values(rows, texts, numbers)
    keys = [name for name in ("trial", "t", "s") if name in rows.frame]
    rows.drop("a row twice", rows.frame.duplicated())
    timeless = find_timeless_trials(rows.frame, keys)
    reason = f"another value at the same {', '.join(keys)}; the first is kept"
    rows.drop(reason, rows.frame.duplicated(keys))

    usable = rows.frame.assign(trial=rows.frame["trial"].map(str))
    series = [name for name in keys if name != "t"]  # one point may follow another
    unordered = int((usable.groupby(series)["t"].diff() < 0).sum())
    rows.frame = usable.sort_values(["trial", "t"], kind="stable")
    lost: list[LostSamples] = []
    unwrapped: dict[str, tuple[str, ...]] = {}
    if table.name == POINTS.name:
        is_lost, lost = find_lost_points(rows.frame)
        rows.frame = rows.frame[~is_lost]
    if table.name in MOTION_TABLES:
        numbers.remove("t")
        is_spike = _hand_spikes(rows.frame, numbers)
        rows.drop("the hand jumps away and back within two samples", is_spike)
    if table.name == ARM.name:
        rows.frame, unwrapped = unwrap_angles(rows.frame, numbers)
    counts = RowCounts(
        total=len(frame),
        dropped=rows.dropped,
        columns=tuple(rows.columns),
        unordered=unordered,
        lost=tuple(lost),
        timeless=timeless,
        unwrapped=unwrapped,
    )
    return rows.frame, counts


def _drop_impossible_values(
    rows: RowFilter, texts: Sequence[str], numbers: Sequence[str]
) -> None:
    """Drop rows with missing required texts or impossible numbers."""
    for name in texts:
        rows.drop(f"no {name}", rows.frame[name].isna(), name)
    for name in numbers:
        is_infinite = ~np.isfinite(rows.frame[name])
        rows.drop(f"{name} is not a finite number", is_infinite, name)
        largest = MAX_TIME_S if name == "t" else MAX_VALUE
        is_beyond = rows.frame[name].abs() > largest
        rows.drop(f"{name} is beyond {largest:.0e}", is_beyond, name)
    if "s" in numbers:
        rows.drop("s is below 0", rows.frame["s"] < -ARC_LENGTH_ROUNDING_M, "s")
    if "sigma" in rows.frame:
        sigma = rows.frame["sigma"]
        is_positive = np.isfinite(sigma) & (sigma > 0)
        rows.drop("sigma is not a number above 0", ~is_positive, "sigma")
        is_tiny = rows.frame["sigma"] < MIN_SIGMA_M
        rows.drop(f"sigma is below {MIN_SIGMA_M:.0e} m", is_tiny, "sigma")


def _hand_spikes(frame: pd.DataFrame, columns: Sequence[str]) -> pd.Series:
    """Find rows of angles or poses that jump away and back; ignore zero rows."""
    is_spike = pd.Series(False, index=frame.index)
    for _, trial in frame.groupby("trial", sort=False):
        values = trial[columns].to_numpy()
        jumps = spike_mask(trial["t"].to_numpy(), np.unwrap(values, axis=0))
        is_spike[trial.index] = jumps & ~zero_row_mask(values)
    return is_spike


def find_timeless_trials(frame: pd.DataFrame, keys: Sequence[str]) -> dict[str, str]:
    """Describe, by trial, times that many rows of one point share.

    `frame` holds rows without repetitions; `keys` are the columns that should identify
    a row, `t` among them.
    """
    places = [name for name in keys if name != "t"]
    if len(places) == len(keys):
        return {}
    groups = frame.groupby(places, sort=False)
    sizes = groups["t"].agg(["size", "nunique"]).reset_index()
    is_shared = sizes["nunique"] * MIN_ROWS_PER_TIME <= sizes["size"]
    sizes = sizes[is_shared & (sizes["size"] >= MIN_TIMED_ROWS)]
    reasons: dict[str, str] = {}
    for _, place in sizes.iterrows():
        is_here = (frame[places] == place[places]).all(axis=1)
        found = describe_shared_times(frame.loc[is_here, "t"].to_numpy(), "s ")
        reason = f"the time stamps carry no time: {found}"
        reasons.setdefault(str(place["trial"]), reason)
    return reasons


def describe_shared_times(t: np.ndarray, unit: str = "") -> str:
    """Describe times (K,) that are not those of single rows; empty if they are.

    unit: of the times, followed by a space.
    """
    distinct = np.unique(t)
    if len(t) < MIN_TIMED_ROWS or len(distinct) * MIN_ROWS_PER_TIME > len(t):
        return ""
    if len(distinct) == 1:
        return f"all {len(t)} rows have the same"
    step = np.median(np.diff(distinct))
    return f"{len(t)} rows have {len(distinct)} different ones, {step:.4g} {unit}apart"


def unwrap_angles(
    frame: pd.DataFrame, joints: Sequence[str]
) -> tuple[pd.DataFrame, dict[str, tuple[str, ...]]]:
    """Unwrap joint angles [rad] that jump by a turn.

    The rows must be in the order of trial and time. Returns the rows, and the trials
    whose angles were wrapped, by joint.
    """
    frame = frame.copy()
    unwrapped: dict[str, tuple[str, ...]] = {}
    for name, trial in frame.groupby("trial", sort=False):
        for joint in joints:
            angles = trial[joint].to_numpy()
            is_jump = np.abs(np.diff(angles)) > TURN_JUMP_RAD
            # angles in degrees also jump, but have a larger range
            if is_jump.any() and np.ptp(angles) < MAX_WRAPPED_RANGE_RAD:
                frame.loc[trial.index, joint] = np.unwrap(angles, discont=TURN_JUMP_RAD)
                unwrapped[joint] = (*unwrapped.get(joint, ()), str(name))
    return frame, unwrapped


def spike_mask(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Find single samples (K, J) at times (K,) [s] that jump away and back, (K,)."""
    is_spike = np.zeros(len(t), dtype=bool)
    if len(t) < 5:  # needs two samples on each side
        return is_spike
    # distance of each sample from the line between its neighbours
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    step = values[2:] - values[:-2]
    offset = values[1:-1] - values[:-2] - share[:, None] * step
    before, middle, after = offset[:-2], offset[1:-1], offset[2:]
    sizes = pd.DataFrame(np.abs(offset))
    window = sizes.rolling(SPIKE_WINDOW_SAMPLES, center=True, min_periods=1)
    typical = window.median().to_numpy()[1:-1]
    opposite = -MIN_RETURN_FRACTION * middle**2
    returns = (before * middle < opposite) & (after * middle < opposite)
    is_large = np.abs(middle) > np.maximum(MIN_SPIKE, SPIKE_RATIO * typical)
    is_spike[2:-2] = (returns & is_large).any(axis=1)
    return is_spike
