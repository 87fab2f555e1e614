"""Columns of a recording as times [s], joint angles [rad], poses and points [m]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    QUATERNION_AXES,
    TIME_UNITS,
    ColumnMeaning,
    split_words,
)
from stringcast.data.lost_samples import zero_row_mask
from stringcast.data.rows import describe_shared_times
from stringcast.data.schema import DataError

# [s] between samples: longer steps show no motion, so the unit must be a smaller one
MAX_STEP_S = 0.5
MAX_ANGLE_RAD = 4 * np.pi  # [rad] that no joint exceeds: larger numbers are degrees
# a clock that turns back farther, in usual steps, did not just swap a few rows
MIN_RETURN_STEPS = 10.0
MAX_RETURN_SHARE = 0.02  # of the rows: more are rows in another order
COUNTS_PER_TURN = 4096  # of the encoders of most servos
# of a position: they have other units than lengths, or none
NO_LENGTH_AXES = {"angle", "likelihood", "valid", *QUATERNION_AXES}
MIN_LIKELIHOOD = 0.6  # likelihood below which a tracker guesses (DeepLabCut's pcutoff)


@dataclass(frozen=True)
class ColumnHints:
    """The user's description of the files, beyond what the names of columns state.

    Attributes
    ----------
    columns
        Our name to theirs, with a sign before it and a shift behind it, as in
        q2: -elbow_deg+90.
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

    columns: Mapping[str, str] = field(default_factory=dict)
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
    words = ", ".join(names[:12]) or "none"
    if len(names) > 12:
        words += f" and {len(names) - 12} more"
    return words


@dataclass(frozen=True)
class RecordingReader:
    """A reader of columns, which lists in `used_columns` how it interpreted them."""

    recording: SourceRecording
    hints: ColumnHints
    columns: Sequence[SourceColumn]
    used_columns: list[UsedColumn]

    @cached_property
    def table(self) -> pd.DataFrame:
        """The recording's table, with rows by number."""
        return self.recording.table.reset_index(drop=True)

    def _numbers(self, name: str) -> pd.Series:
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
        raw = self._numbers(column.name).to_numpy(dtype=float)
        values: np.ndarray = column.sign * raw + column.shift
        values = values * factor
        if not np.isfinite(values).any():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds no number. "
                f"Correct it, or name another with --map {role}=<column>."
            )
        self._note(column, role, unit, how, values)
        return values

    def _note(
        self, column: SourceColumn, role: str, unit: str, how: str, values: np.ndarray
    ) -> None:
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

    def read_times(self) -> np.ndarray:
        """Read times, (K,) [s], of the best column of times or of the frame numbers."""
        if clocks := self.columns_of("time"):
            # one that the user named first, then the shortest name
            clocks.sort(key=lambda c: (c.how != "--map", len(c.meaning.name.split())))
            self._refuse_restarted_clock(clocks[0])
            fault = self._stamp_fault(clocks[0])
            if not fault:
                return self._read_clock(clocks[0])
            if self.hints.fps is None:
                raise DataError(
                    f"{self.recording.file}: {fault}. Give the rate of its rows, as in "
                    "--fps 200, or export times as 64-bit numbers."
                )
        fps = self.hints.fps or self.recording.fps
        if fps is None:
            raise DataError(
                f"{self.recording.file}: no column holds times; there are "
                f"{list_columns(self.recording)}. Name it with --map t=<column>, or "
                "give the camera's rate with --fps 200."
            )
        if numbers := self.columns_of("frame"):
            how = "--fps" if self.hints.fps else "file"
            unit = f"frames, {fps:g} a second"
            return self.read_numbers(numbers[0], "t", unit, 1 / fps, how)
        self._refuse_unknown_counter()
        return np.arange(len(self.table)) / fps

    def _rows_of_series(self) -> pd.Series:
        """Name the series of each row, (K,): its trial, and its place on the string."""
        columns = [*self.columns_of("trial"), *self.columns_of("arc")]
        series = pd.Series("", index=self.table.index)
        for column in columns:
            series = series + " " + self.table[column.name].astype(str)
        return series

    def _stamp_fault(self, column: SourceColumn) -> str:
        """Say why the time stamps of a column carry no time; empty if they do."""
        stamps = self._numbers(column.name).dropna()
        for name, values in stamps.groupby(self._rows_of_series()):
            found = describe_shared_times(values.to_numpy(float))
            if not found:
                continue
            trial = f" of trial{name}" if str(name).strip() else ""
            is_rounded = (values == values.astype(np.float32)).all()
            is_large = np.spacing(np.float32(values.abs().max())) > 1e-3
            guess = " (stored as float32?)" if is_rounded and is_large else ""
            return f"the time stamps{trial} carry no time: {found}{guess}"
        return ""

    def _refuse_restarted_clock(self, column: SourceColumn) -> None:
        """Refuse a clock that begins again within a trial: two recordings in one.

        Rows in another order are none: their times do not overlap.
        """
        stamps = self._numbers(column.name).dropna()
        for name, values in stamps.groupby(self._rows_of_series()):
            t = values.to_numpy(dtype=float)
            steps = np.diff(t)
            usual = float(np.median(np.abs(steps))) if len(steps) else 0.0
            returns = np.flatnonzero(steps < -MIN_RETURN_STEPS * usual)
            if not len(returns) or len(returns) > MAX_RETURN_SHARE * len(t) + 1:
                continue
            first = int(returns[0]) + 1
            before, after = t[:first], t[first:]
            if not ((after > before.min()) & (after < before.max())).any():
                continue
            trial = f" of trial{name}" if str(name).strip() else ""
            raise DataError(
                f"{self.recording.file}: column '{column.name}'{trial} goes back from "
                f"{t[first - 1]:.10g} to {t[first]:.10g} in row {first + 1}, to times "
                "that were already recorded: two recordings seem to be in one. Give "
                "each a file of its own, or a column 'trial'."
            )

    def _refuse_unknown_counter(self) -> None:
        """Refuse rows without times if a column may hold the numbers of frames.

        A column that counts every row says the same as the rows themselves.
        """
        series = self._rows_of_series()
        used = {column.name for column in self.columns}
        for name in map(str, self.table):
            if name in used:
                continue
            numbers = self._numbers(name)
            if not np.isfinite(numbers).all() or (numbers % 1 != 0).any():
                continue
            steps = numbers.groupby(series).diff().dropna()
            if len(steps) and (steps > 0).all() and (steps != 1).any():
                raise DataError(
                    f"{self.recording.file}: no column holds times, and '{name}' "
                    "increases by whole numbers that are not all 1. If it is the "
                    f"number of the frame: --map 'frame={name}'; if not, take the "
                    "column out."
                )

    def _read_clock(self, column: SourceColumn) -> np.ndarray:
        """Read a column of times [s]: numbers of any unit, or dates."""
        numbers = self._numbers(column.name)
        if numbers.isna().all():
            return self._read_dates(column)
        step = _typical_step(numbers)
        unit, how = column.meaning.unit, column.how
        if unit:
            self._refuse_slow_clock(column, step)
        else:
            unit = _time_unit(step)
            how = column.how if unit == "s" else "values"
        return self.read_numbers(column, "t", unit, TIME_UNITS[unit], how)

    def _read_dates(self, column: SourceColumn) -> np.ndarray:
        """Read a column of dates as seconds since 1970."""
        raw = self.table[column.name]
        dates = pd.Series(pd.NaT, index=raw.index)
        if not pd.api.types.is_float_dtype(raw):  # as of infinite numbers
            with suppress(ValueError, TypeError, OverflowError):
                dates = pd.to_datetime(raw, errors="coerce", utc=True, format="ISO8601")
        if dates.isna().all():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds neither numbers "
                "nor dates such as 2026-01-31 12:00:00.005; it holds "
                f"{str(raw.iloc[0])[:40]!r}. Name another with --map t=<column>."
            )
        elapsed = dates - pd.Timestamp(0, tz="UTC")
        seconds: np.ndarray = elapsed.dt.total_seconds().to_numpy(dtype=float)
        self._note(column, "t", "dates", "values", seconds)
        return seconds

    def _refuse_slow_clock(self, column: SourceColumn, step: float) -> None:
        """Refuse a unit in which samples are too far apart to show a motion.

        step: typical difference of the numbers from row to row.
        """
        unit = column.meaning.unit
        if step * TIME_UNITS[unit] <= MAX_STEP_S:
            return
        likely = _time_unit(step)
        renamed = f"t_{likely}" if likely != unit else "t_<unit>"
        raise DataError(
            f"{self.recording.file}: column '{column.name}' holds times in {unit} by "
            f"its name, but its rows are {step:.4g} {unit} apart, which shows no "
            f"motion. If they are in {likely}, call the column {renamed}."
        )

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
        if of_file and self._names_state_unit("point", "arc", "hand"):
            return of_file  # against the names
        return column.meaning.unit or of_file or stated.get("") or "m"

    def _names_state_unit(self, *kinds: str) -> bool:
        """Whether all names of columns of these kinds state a unit."""
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
        is_open = not unit or self._names_state_unit("joint")
        if is_open and self.hints.degrees is not None:
            unit, how = ("deg", "--deg") if self.hints.degrees else ("rad", "--rad")
        if not unit and self.recording.angle_question:
            raise DataError(f"{self.recording.file}: {self.recording.angle_question}")
        if not unit:
            names = [c.name for c in same_unit or [column]]
            numbers = pd.DataFrame({name: self._numbers(name) for name in names})
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

    def read_motion(self) -> pd.DataFrame | None:
        """Read joint angles or poses of the hand; None if there are none."""
        joints = self.columns_of("joint")
        if joints:
            joints.sort(key=lambda column: int(column.meaning.name))
            self._refuse_alike_joints(joints)
            self._refuse_joint_of_other_unit(joints)
            unitless = [c for c in joints if not c.meaning.unit]  # all in one unit
            angles = {
                f"q{n}": self.read_angle(column, f"q{n}", unitless)
                for n, column in enumerate(joints, 1)
            }
            table = pd.DataFrame(angles)
            if self.hints.absolute:
                table = table.diff(axis=1).fillna({"q1": table["q1"]})
            return table
        hand = {column.meaning.axis: column for column in self._hand_columns()}
        has_direction = "angle" in hand or hand.keys() >= {*QUATERNION_AXES}
        if len({"x", "y", "z"} & {*hand}) < 2 or not has_direction:
            return None  # a position that a tracker saw
        right, up = self.plane_axes
        pose = self._xy(hand, "")
        # direction in which the string leaves: a column, or x turned by a quaternion
        if "angle" in hand:
            pose["theta"] = self.read_angle(hand["angle"], "theta")
        else:
            direction = self._turned_x(hand)
            rise = up.sign * direction[up.name]
            run = right.sign * direction[right.name]
            pose["theta"] = np.unwrap(np.arctan2(rise, run))
        return pd.DataFrame(pose)

    def zero_rows(self) -> np.ndarray:
        """Find rows of the hand's log that are exactly zero among others, (K,) bool."""
        columns = self.columns_of("joint") or self._hand_columns()
        values = np.empty((len(self.table), len(columns)))
        for number, column in enumerate(columns):
            units = ANGLE_UNITS | LENGTH_UNITS
            raw = self._numbers(column.name)
            values[:, number] = raw * units.get(column.meaning.unit, 1.0)
        return zero_row_mask(values)

    def _refuse_alike_joints(self, joints: Sequence[SourceColumn]) -> None:
        """Refuse two columns of the same joint."""
        for one, other in pairwise(joints):
            if one.meaning.name == other.meaning.name:
                raise DataError(
                    f"{self.recording.file}: the columns '{one.name}' and "
                    f"'{other.name}' both seem to be joint {one.meaning.name}. Name "
                    f"the joints, base first: --map 'q1={one.name}' --map q2=<column>."
                )

    def _refuse_joint_of_other_unit(self, joints: Sequence[SourceColumn]) -> None:
        """Refuse a joint that turns farther than any does, among others that do not."""
        largest = {}
        for column in joints:
            raw = self._numbers(column.name)
            factor = ANGLE_UNITS.get(column.meaning.unit, ANGLE_UNITS["deg"])
            largest[column.name] = float(raw.abs().quantile(0.9)) * factor
        too_far = [name for name in largest if largest[name] > MAX_ANGLE_RAD]
        if len(too_far) in (0, len(joints)):
            return
        name = too_far[0]
        turned = np.degrees(largest[name])
        raise DataError(
            f"{self.recording.file}: column '{name}' reaches {turned:.0f} degrees, "
            "which no joint does, and the other joints do not. If it holds the counts "
            f"of an encoder, {COUNTS_PER_TURN} a turn, multiply it by "
            f"{360 / COUNTS_PER_TURN:.6g}; if it is no joint, name those that are: "
            "--map q1=<column>."
        )

    def _hand_columns(self) -> list[SourceColumn]:
        """Return the columns of the body that is the hand.

        Raises DataError if several bodies could be it, or none has the stated name.
        """
        columns = self.columns_of("hand")
        axes_of: dict[str, set[str]] = {}
        for column in columns:
            axes_of.setdefault(column.meaning.name, set()).add(column.meaning.axis)
        bodies = [name for name, axes in axes_of.items() if len(axes & {*"xyz"}) > 1]
        if self.hints.hand:
            stated = {*split_words(self.hints.hand)}
            named = [name for name in bodies if stated <= {*name.split()}]
            if bodies and len(named) != 1:
                raise DataError(
                    f"--hand {self.hints.hand}: {self.recording.file} has the bodies "
                    f"{', '.join(bodies)}. Name one of them."
                )
            return [c for c in columns if c.meaning.name in named]
        if len(bodies) < 2:
            return columns
        complete = []
        for name in bodies:
            axes = axes_of[name]
            if "angle" in axes or axes >= {*QUATERNION_AXES}:
                complete.append(name)
        if len(complete) == 1:
            return [c for c in columns if c.meaning.name == complete[0]]
        words = [name.removeprefix("hand ") for name in bodies]
        raise DataError(
            f"{self.recording.file}: several bodies could be the hand: "
            f"{', '.join(words)}. Name the one that holds the string: "
            f"--hand '{words[0]}'."
        )

    def _xy(
        self, columns: Mapping[str, SourceColumn], prefix: str
    ) -> dict[str, np.ndarray]:
        """Read positions in the plane of motion, x and y, (K,) each [m]."""
        right, up = self.plane_axes
        x = right.sign * self.read_length(columns[right.name], f"{prefix}x")
        y = up.sign * self.read_length(columns[up.name], f"{prefix}y")
        return {"x": x, "y": y}

    def _turned_x(self, hand: Mapping[str, SourceColumn]) -> dict[str, np.ndarray]:
        """Turn the x-axis by the hand's quaternion; components (K,) by name."""
        x, y, z, w = (
            self.read_numbers(hand[name], name, "1", 1.0, "name")
            for name in QUATERNION_AXES
        )
        return {
            "x": 1 - 2 * (y**2 + z**2),
            "y": 2 * (x * y + w * z),
            "z": 2 * (x * z - w * y),
        }

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

    def read_points(self) -> pd.DataFrame | None:
        """Read the points of the string, one row per sample and point.

        The index is that of the samples. None stands for a recording without points.
        """
        axes_of: dict[str, dict[str, SourceColumn]] = {}
        for column in self.columns_of("point"):
            axes = axes_of.setdefault(column.meaning.name, {})
            # of a place in metres and in pixels, that in metres counts
            if column.meaning.axis in axes and column.meaning.unit == "px":
                continue
            axes[column.meaning.axis] = column
        tables = []
        for name, axes in axes_of.items():
            coordinates = sorted({"x", "y", "z"} & {*axes})
            if len(coordinates) >= 2:
                tables.append(self._read_point(name, axes))
            elif coordinates:
                self._refuse_single_coordinate(axes[coordinates[0]])
        return pd.concat(tables) if tables else None

    def _refuse_single_coordinate(self, column: SourceColumn) -> None:
        """Raise DataError for a point with one coordinate: its others are missing."""
        meaning = column.meaning
        other = "y" if meaning.axis == "x" else "x"
        point = meaning.name or "tip"
        raise DataError(
            f"{self.recording.file}: column '{column.name}' is the only coordinate of "
            f"the point '{point}'; its {other} is missing. There are "
            f"{list_columns(self.recording)}. Add the column, or name the columns of "
            f"the points that count: --map {point}.x=<column> "
            f"--map {point}.y=<column>."
        )

    def _read_point(self, name: str, axes: Mapping[str, SourceColumn]) -> pd.DataFrame:
        """Read one point of the string over time."""
        prefix = f"{name}." if name else ""
        xy = self._xy(axes, prefix)
        right, _ = self.plane_axes
        if self.length_unit(axes[right.name]) == "px":
            scale, origin = self.hints.px_per_m, self.hints.origin_px
            if scale is None or origin is None:
                raise DataError(
                    f"{self.recording.file}: positions are in pixels. Give the pixels "
                    "of a metre and the pixel of the world's origin: "
                    "--px-per-m 340 --origin-px 251.5,387.5."
                )
            # rows of pixels are counted from the top
            x, y = (xy["x"] - origin[0]) / scale, (origin[1] - xy["y"]) / scale
            xy = {"x": x, "y": y}
        frame = pd.DataFrame({"point": name, **xy})
        if arcs := self.columns_of("arc"):
            frame["s"] = self.read_length(arcs[0], "s")
        if "sigma" in axes:
            frame["sigma"] = self.read_length(axes["sigma"], f"{prefix}sigma")
        role = f"{prefix}valid"
        if "likelihood" in axes:
            column = axes["likelihood"]
            likelihood = self.read_numbers(
                column, role, f"> {MIN_LIKELIHOOD}", 1.0, "name"
            )
            frame["valid"] = likelihood > MIN_LIKELIHOOD
        elif "valid" in axes:
            frame["valid"] = self.read_numbers(axes["valid"], role, "", 1.0, "name") > 0
        return frame


def _typical_step(numbers: pd.Series) -> float:
    """Return the median difference of distinct numbers; 0 if there is one only."""
    steps = np.diff(np.unique(numbers.dropna()))
    return float(np.median(steps)) if len(steps) else 0.0


def _time_unit(step: float) -> str:
    """Choose the largest unit in which a step between samples is short."""
    for unit in ("s", "ms", "us", "ns"):
        if step * TIME_UNITS[unit] < MAX_STEP_S:
            return unit
    return "s"


def _signed_axis(text: str) -> PlaneAxis:
    return PlaneAxis(text.lstrip("-"), -1.0 if text[0] == "-" else 1.0)
