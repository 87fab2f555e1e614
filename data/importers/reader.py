"""Columns of a recording as times [s], joint angles [rad], poses and points [m]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    QUATERNION_AXES,
    ColumnMeaning,
)
from stringcast.data.schema import DataError

MAX_ANGLE_RAD = 4 * np.pi  # [rad] that no joint exceeds: larger numbers are degrees
COUNTS_PER_TURN = 4096  # of the encoders of most servos
MAX_LISTED_COLUMNS = 12  # in a message
# of a position: they have other units than lengths, or none
NO_LENGTH_AXES = {"angle", "likelihood", "valid", *QUATERNION_AXES}


@dataclass(frozen=True)
class ColumnHints:
    """The user's description of the files, beyond what the names of columns state.

    Attributes
    ----------
    columns
        Our name and theirs, with a sign before it and a shift behind it, as in
        q2, -elbow_deg+90. Files may call one thing differently.
    unit
        Unit of lengths by the file's name, or of all files under the empty name.
    degrees
        Whether angles are in degrees where names do not state their unit, or where all
        names do, against the names; None: detected from their range.
    counts
        Whether joint angles are counts of an encoder, 4096 a turn.
    absolute
        Whether joint angles count from +x, and not from the link before.
    y_is_down
        Whether y of points is counted downwards.
    plane
        The two of three directions that are x and y, each with a sign.
    fps
        Frame rate of files without times [1/s].
    clock
        Seconds to be added to the times of points.
    px_per_m, origin_px
        Scale and origin of pixels.
    hand
        The body that is the hand, where files name several.
    skip_zeros
        Whether rows of the hand's log that are exactly zero among others are left out.
    """

    columns: Sequence[tuple[str, str]] = ()
    unit: Mapping[str, str] = field(default_factory=dict)
    degrees: bool | None = None
    counts: bool = False
    absolute: bool = False
    y_is_down: bool = False
    plane: str = ""
    fps: float | None = None
    clock: float = 0.0
    px_per_m: float | None = None
    origin_px: tuple[float, float] | None = None
    hand: str = ""
    skip_zeros: bool = False


@dataclass(frozen=True)
class UsedColumn:
    """A used column as it was interpreted.

    unit: in which it is stored. how: source of the unit: name, values, or an option.
    low, high: range of its numbers, in our units.
    """

    file: Path
    column: str
    role: str
    unit: str
    how: str
    low: float = np.nan
    high: float = np.nan


@dataclass(frozen=True)
class SourceColumn:
    """A column to be read, with its sign, and its shift in its own unit."""

    name: str
    meaning: ColumnMeaning
    how: str = "name"
    sign: float = 1.0
    shift: float = 0.0


@dataclass(frozen=True)
class PlaneAxis:
    """A direction of a file; the sign is negative if ours is opposite."""

    name: str
    sign: float = 1.0


def trial_name(key: str) -> str:
    """Name a trial by what distinguishes it; numbers alone are no names."""
    return f"t{key}" if key.isdigit() else key


def list_columns(recording: SourceRecording) -> str:
    """List the first columns of a recording for messages."""
    names = [str(name) for name in recording.table]
    words = ", ".join(names[:MAX_LISTED_COLUMNS]) or "none"
    more = len(names) - MAX_LISTED_COLUMNS
    if more > 0:
        words += f" and {more} more"
    return words


@dataclass(frozen=True)
class RecordingReader:
    """A reader of columns, which lists in `used_columns` how it interpreted them."""

    recording: SourceRecording
    hints: ColumnHints
    columns: Sequence[SourceColumn]
    used_columns: list[UsedColumn] = field(default_factory=list)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The recording's table, with rows by number."""
        return self.recording.table.reset_index(drop=True)

    def numbers(self, name: str) -> pd.Series:
        """Return the numbers of a column, (K,); what is none, or infinite, is NaN."""
        numbers = pd.to_numeric(self.table[name], errors="coerce")
        if numbers.dtype == bool:
            numbers = numbers.astype(float)
        return numbers.where(np.isfinite(numbers))

    def columns_of(self, kind: str) -> list[SourceColumn]:
        """Return the columns of one kind of meaning."""
        return [column for column in self.columns if column.meaning.kind == kind]

    def read_numbers(
        self, column: SourceColumn, role: str, unit: str, factor: float, how: str
    ) -> np.ndarray:
        """Read a column of numbers, (K,) [our unit].

        Raises DataError if it holds no number.
        """
        raw = self.numbers(column.name).to_numpy(dtype=float)
        values: np.ndarray = column.sign * raw + column.shift
        values = values * factor
        if not np.isfinite(values).any():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds no number. "
                f"Correct it, or name another with --map {role}=<column>."
            )
        self.note_use(column, role, unit, how, values)
        return values

    def note_use(
        self, column: SourceColumn, role: str, unit: str, how: str, values: np.ndarray
    ) -> None:
        """List a column as used, with the range of its numbers (K,) [our unit]."""
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        self.used_columns.append(
            UsedColumn(self.recording.file, column.name, role, unit, how, low, high)
        )

    def read_names(self, column: SourceColumn) -> np.ndarray:
        """Read names of trials, (K,).

        Raises DataError if a row has none.
        """
        names = self.table[column.name]
        count = int(names.isna().sum())
        if count > 0:
            raise DataError(
                f"{self.recording.file}: {count} of {len(names)} rows name no trial in "
                f"column '{column.name}'. Name it there, or take the rows out."
            )
        self.used_columns.append(
            UsedColumn(self.recording.file, column.name, "trial", "", column.how)
        )
        return np.asarray(names.astype(str).map(trial_name))

    def read_length(self, column: SourceColumn, role: str) -> np.ndarray:
        """Read a column of lengths, (K,) [m], or of pixels."""
        unit, how = self.length_unit(column), column.how
        if not column.meaning.unit and self.hints.unit:
            how = "--unit"
        factor = 1.0 if unit == "px" else LENGTH_UNITS[unit]
        return self.read_numbers(column, role, unit, factor, how)

    def length_unit(self, column: SourceColumn) -> str:
        """Find the unit of lengths: from the name, else as stated, else metres."""
        stated = self.hints.unit
        of_file = stated.get(self.recording.file.name)
        if of_file and self.names_state_unit("point", "arc", "hand"):
            return of_file  # against the names
        return column.meaning.unit or of_file or stated.get("") or "m"

    def names_state_unit(self, *kinds: str) -> bool:
        """Return whether all names of columns of these kinds state a unit."""
        columns = [c for kind in kinds for c in self.columns_of(kind)]
        columns = [c for c in columns if c.meaning.axis not in NO_LENGTH_AXES]
        return all(column.meaning.unit for column in columns)

    def read_angle(
        self, column: SourceColumn, role: str, same_unit: Sequence[SourceColumn] = ()
    ) -> np.ndarray:
        """Read a column of angles, (K,) [rad].

        same_unit: columns without a unit that share the one of this column.
        """
        unit, how = column.meaning.unit, column.how
        if self.hints.counts and role.startswith("q"):
            return self._read_counts(column, role)
        is_open = not unit or self.names_state_unit("joint")
        if is_open and self.hints.degrees is not None:
            unit, how = ("deg", "--deg") if self.hints.degrees else ("rad", "--rad")
        if not unit and self.recording.angle_question:
            raise DataError(f"{self.recording.file}: {self.recording.angle_question}")
        if not unit:
            names = [c.name for c in same_unit or [column]]
            numbers = pd.DataFrame({name: self.numbers(name) for name in names})
            # of the joint that turns farthest
            largest = float(numbers.abs().quantile(0.9).max())
            unit = "rad"
            if largest > MAX_ANGLE_RAD:
                unit, how = "deg", "values"
        return self.read_numbers(column, role, unit, ANGLE_UNITS[unit], how)

    def _read_counts(self, column: SourceColumn, role: str) -> np.ndarray:
        """Read an encoder's counts as an angle that does not wrap, (K,) [rad]."""
        turn = 2 * np.pi / COUNTS_PER_TURN
        unit = f"counts, {COUNTS_PER_TURN} a turn"
        angles = self.read_numbers(column, role, unit, turn, "--counts")
        is_known = np.isfinite(angles)
        angles[is_known] = np.unwrap(angles[is_known])
        return angles

    @cached_property
    def plane_axes(self) -> tuple[PlaneAxis, PlaneAxis]:
        """The file's directions of x and y.

        They are the two that exist, or those of three that the user named.
        """
        if self.hints.plane:
            right, up = self.hints.plane.split(",")
            return _signed_axis(right), _signed_axis(up)
        points = self.columns_of("point")
        axes = {column.meaning.axis for column in (*self.columns_of("hand"), *points)}
        names = sorted(axes & {"x", "y", "z"})
        if len(names) < 3:
            is_down = self.hints.y_is_down and points
            return PlaneAxis(names[0]), PlaneAxis(names[1], -1.0 if is_down else 1.0)
        raise DataError(
            f"{self.recording.file}: positions have three coordinates, a cast has two. "
            "Choose those to the right and up: --plane x,z, or --plane=-z,y if z "
            "points to the left."
        )

    def read_xy(
        self, columns: Mapping[str, SourceColumn], prefix: str
    ) -> dict[str, np.ndarray]:
        """Read positions in the plane of motion, x and y, (K,) each [m]."""
        right, up = self.plane_axes
        x = right.sign * self.read_length(columns[right.name], f"{prefix}x")
        y = up.sign * self.read_length(columns[up.name], f"{prefix}y")
        return {"x": x, "y": y}


def _signed_axis(text: str) -> PlaneAxis:
    return PlaneAxis(text.lstrip("-"), -1.0 if text[0] == "-" else 1.0)
