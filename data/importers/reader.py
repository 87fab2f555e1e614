"""Conversion of a recording's columns to times [s], angles [rad] and lengths [m]."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
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

MAX_ANGLE_RAD = 4 * np.pi  # [rad]: larger numbers are degrees
COUNTS_PER_TURN = 4096  # encoders of most servos
MAX_LISTED_COLUMNS = 12  # in a message
# axes that are not lengths
NO_LENGTH_AXES = {"angle", "likelihood", "valid", *QUATERNION_AXES}


@dataclass(frozen=True)
class ColumnHints:
    """The user's description of the files, in addition to column names.

    Attributes
    ----------
    columns
        Our name and the column, with sign and shift: `q2`, `-elbow_deg+90`. A name may
        occur repeatedly, for files with other columns.
    unit
        Unit of lengths by file name; the empty name means all files.
    degrees
        Whether angles without a unit are in degrees. If all names have a unit, this
        overrides it. None: detected from the range.
    counts
        Whether joint angles are counts of an encoder, 4096 a turn.
    absolute
        Whether joint angles are relative to +x instead of the previous link.
    y_is_down
        Whether y of points points down.
    plane
        Which two of three axes are x and y, with signs.
    fps
        Frame rate of files without times [1/s].
    clock
        Offset to add to times of points [s].
    px_per_m, origin_px
        Scale and origin of pixels.
    hand
        Name of the hand, if files have several bodies.
    skip_zeros
        Whether zero rows among others in the hand's log are left out.
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
    """A used column and its interpretation.

    unit: stored unit. how: source of the unit: name, values or an option. low, high:
    range in our units.
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
    """A column to read, with its sign, and its shift in the stored unit."""

    name: str
    meaning: ColumnMeaning
    how: str = "name"
    sign: float = 1.0
    shift: float = 0.0


@dataclass(frozen=True)
class PlaneAxis:
    """An axis of a file; the sign is negative if ours points the other way."""

    name: str
    sign: float = 1.0


def trial_name(key: str) -> str:
    """Name a trial; a number gets the prefix t."""
    return f"t{key}" if key.isdigit() else key


ONLY_TRIAL = trial_name("00")  # of one pair of files


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
    """A reader of columns; `used_columns` lists its interpretations."""

    recording: SourceRecording
    hints: ColumnHints
    columns: Sequence[SourceColumn]
    used_columns: list[UsedColumn] = field(default_factory=list)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The recording's table, with rows by number."""
        return self.recording.table.reset_index(drop=True)

    def numbers(self, name: str) -> pd.Series:
        """Return the numbers of a column, (K,), NaN for anything else or infinity."""
        numbers = pd.to_numeric(self.table[name], errors="coerce")
        if numbers.dtype == bool:
            numbers = numbers.astype(float)
        return numbers.where(np.isfinite(numbers))

    def columns_of(self, kind: str) -> list[SourceColumn]:
        """Return the columns of one kind."""
        return [column for column in self.columns if column.meaning.kind == kind]

    def read_numbers(
        self, column: SourceColumn, role: str, unit: str, factor: float, how: str
    ) -> np.ndarray:
        """Read a column of numbers, (K,) [our unit].

        Raises DataError if it holds no number.
        """
        raw = self.numbers(column.name).to_numpy(dtype=float)
        values = column.sign * raw + column.shift
        values = values * factor
        if not np.isfinite(values).any():
            raise DataError(
                self.recording.file,
                f"column '{column.name}' holds no number",
                f"Correct it, or name another with --map {role}=<column>.",
                field=column.name,
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

    def read_names(self, column: SourceColumn, role: str) -> pd.Series:
        """Read a column of names, of trials or points, (K,).

        Raises DataError if a row has none.
        """
        names = self.table[column.name]
        count = int(names.isna().sum())
        if count > 0:
            raise DataError(
                self.recording.file,
                f"{count} of {len(names)} rows name no {role} in column "
                f"'{column.name}'",
                "Name it there, or take the rows out.",
                field=column.name,
            )
        self.used_columns.append(
            UsedColumn(self.recording.file, column.name, role, "", column.how)
        )
        return names.astype(str)

    def read_length(self, column: SourceColumn, role: str) -> np.ndarray:
        """Read a column of lengths, (K,) [m], or of pixels."""
        unit, how = self.length_unit(column), column.how
        if not column.meaning.unit and self.hints.unit:
            how = "--unit"
        factor = 1.0 if unit == "px" else LENGTH_UNITS[unit]
        return self.read_numbers(column, role, unit, factor, how)

    def length_unit(self, column: SourceColumn) -> str:
        """Find the unit of lengths: from the name, the options, or metres."""
        stated = self.hints.unit
        of_file = stated.get(self.recording.file.name)
        if of_file and self.names_state_unit("point", "arc", "hand"):
            return of_file  # overrides the names
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

        same_unit: columns without a stated unit that share this one's.
        """
        unit, how = column.meaning.unit, column.how
        if self.hints.counts and role.startswith("q"):
            return self._read_counts(column, role)
        is_open = not unit or self.names_state_unit("joint")
        if is_open and self.hints.degrees is not None:
            unit, how = ("deg", "--deg") if self.hints.degrees else ("rad", "--rad")
        if not unit and self.recording.angle_question:
            raise DataError(self.recording.file, self.recording.angle_question)
        if not unit:
            names = [c.name for c in same_unit or [column]]
            numbers = pd.DataFrame({name: self.numbers(name) for name in names})
            # the largest angle of all joints
            largest = float(numbers.abs().quantile(0.9).max())
            unit = "rad"
            if largest > MAX_ANGLE_RAD:
                unit, how = "deg", "values"
        return self.read_numbers(column, role, unit, ANGLE_UNITS[unit], how)

    def _read_counts(self, column: SourceColumn, role: str) -> np.ndarray:
        """Read encoder counts as an unwrapped angle, (K,) [rad]."""
        turn = 2 * np.pi / COUNTS_PER_TURN
        unit = f"counts, {COUNTS_PER_TURN} a turn"
        angles = self.read_numbers(column, role, unit, turn, "--counts")
        is_known = np.isfinite(angles)
        angles[is_known] = np.unwrap(angles[is_known])
        return angles

    @cached_property
    def plane_axes(self) -> tuple[PlaneAxis, PlaneAxis]:
        """The file's axes for x and y.

        The user must choose them from three.
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
            self.recording.file,
            "positions have three coordinates, a cast has two",
            "Choose those to the right and up: --plane x,z, or --plane=-z,y if "
            "z points to the left.",
        )

    def axes_of(self, columns: Collection[str]) -> tuple[PlaneAxis, PlaneAxis]:
        """Return the axes for x and y of a body with these columns.

        A body with two coordinates other than the stated ones was measured in the
        plane of motion, such as the points of a single camera.
        """
        right, up = self.plane_axes
        names = sorted({"x", "y", "z"} & {*columns})
        if len(names) == 2 and {right.name, up.name} != {*names}:
            is_down = self.hints.y_is_down and not self.columns_of("hand")
            return PlaneAxis(names[0]), PlaneAxis(names[1], -1.0 if is_down else 1.0)
        return right, up

    def read_xy(
        self, columns: Mapping[str, SourceColumn], prefix: str
    ) -> dict[str, np.ndarray]:
        """Read positions in the plane of motion, x and y, (K,) each [m]."""
        right, up = self.axes_of(columns)
        x = right.sign * self.read_length(columns[right.name], f"{prefix}x")
        y = up.sign * self.read_length(columns[up.name], f"{prefix}y")
        return {"x": x, "y": y}


def _signed_axis(text: str) -> PlaneAxis:
    return PlaneAxis(text.lstrip("-"), -1.0 if text[0] == "-" else 1.0)
