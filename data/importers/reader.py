"""Columns of a recording as numbers of ours: times [s], joint angles [rad], poses and
points [m].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
)
from stringcast.data.schema import DataError

# [s] between samples at most: from longer ones no motion can be told, so that they
# count in a smaller unit
MAX_STEP_S = 0.5
MAX_ANGLE_RAD = 4 * np.pi  # [rad] further no joint turns: larger angles are in degrees
# of a tracker's own likelihood: below it says that it guesses (DeepLabCut's pcutoff)
MIN_LIKELIHOOD = 0.6


@dataclass(frozen=True)
class ColumnHints:
    """The user's description of the files, beyond what the names of columns tell.

    columns: our name to theirs, with a sign before it and a shift behind it, as in q2:
    -elbow_deg+90. unit: of lengths, by the file's name, or of all under the empty name.
    degrees: what angles without a unit are in; None: as they turn. down: y of points is
    counted down. plane: which two of three directions are x and y, each with a sign.
    fps: of files without times [1/s]. clock: to be added to the times of points [s].
    px_per_m, origin_px: of pixels.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: Mapping[str, str] = field(default_factory=dict)
    degrees: bool | None = None
    y_is_down: bool = False
    plane: str = ""
    fps: float | None = None
    clock: float = 0.0
    px_per_m: float | None = None
    origin_px: tuple[float, float] | None = None


@dataclass(frozen=True)
class UsedColumn:
    """A column as it was understood. role: as what. unit: in which it is. how: by name,
    by its values, or as was said. low, high: of its numbers, in our units.
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
    """One column on its way: its role, unit, sign, and shift in its own unit."""

    name: str
    meaning: ColumnMeaning
    how: str = "name"
    sign: float = 1.0
    shift: float = 0.0


def trial_name(key: str) -> str:
    """A trial's name of what distinguishes it: numbers alone are no names."""
    return f"t{key}" if key.isdigit() else key


def list_columns(recording: SourceRecording) -> str:
    """The first columns of a recording, for messages."""
    names = [str(name) for name in recording.table]
    return (
        ", ".join(names[:12])
        + (f" and {len(names) - 12} more" if len(names) > 12 else "")
        if names
        else "none"
    )


@dataclass(frozen=True)
class RecordingReader:
    """Turns columns of a recording into numbers of ours, and notes in `taken` how each
    was understood.
    """

    recording: SourceRecording
    hints: ColumnHints
    used_columns: list[UsedColumn]

    def read_numbers(
        self, column: SourceColumn, role: str, unit: str, factor: float, how: str
    ) -> np.ndarray:
        """A column [our unit]; raises DataError where it holds no number."""
        raw = pd.to_numeric(
            self.recording.table[column.name], errors="coerce"
        ).to_numpy(dtype=float)
        values = (column.sign * raw + column.shift) * factor
        if not np.isfinite(values).any():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds no number. Correct it, or name another with "
                f"--map {role}=<column>."
            )
        self.used_columns.append(
            UsedColumn(
                self.recording.file,
                column.name,
                role,
                unit,
                how,
                float(np.nanmin(values)),
                float(np.nanmax(values)),
            )
        )
        return values

    def read_names(self, column: SourceColumn) -> np.ndarray:
        """Names of trials."""
        self.used_columns.append(
            UsedColumn(self.recording.file, column.name, "trial", "", column.how)
        )
        return self.recording.table[column.name].astype(str).map(trial_name).to_numpy()

    def read_times(self, columns: Sequence[SourceColumn]) -> np.ndarray:
        """Times [s]: of the best column of times, or of the frames' numbers."""
        found = [column for column in columns if column.meaning.kind == "time"]
        if found:
            column = min(
                found, key=lambda c: (c.how != "--map", len(c.meaning.name.split()))
            )
            return self._read_clock(column)
        fps = self.hints.fps or self.recording.fps
        if fps is None:
            raise DataError(
                f"{self.recording.file}: no column holds times; there are {list_columns(self.recording)}. Name it with "
                "--map t=<column>, or give the camera's rate with --fps 200."
            )
        frame = next(
            (column for column in columns if column.meaning.kind == "frame"), None
        )
        if frame is None:
            return np.arange(len(self.recording.table)) / fps
        return self.read_numbers(
            frame,
            "t",
            f"frames, {fps:g} a second",
            1 / fps,
            "--fps" if self.hints.fps else "file",
        )

    def _read_clock(self, column: SourceColumn) -> np.ndarray:
        """A column of times [s]: numbers in the unit that its name says or its steps
        tell, or dates.
        """
        raw = self.recording.table[column.name]
        numbers = pd.to_numeric(raw, errors="coerce")
        if numbers.notna().any():
            unit, how = column.meaning.unit, column.how
            if not unit:
                steps = np.diff(np.unique(numbers.dropna()))
                usual = float(np.median(steps)) if len(steps) else 0.0
                unit = next(
                    (
                        u
                        for u in ("s", "ms", "us", "ns")
                        if usual * TIME_UNITS[u] < MAX_STEP_S
                    ),
                    "s",
                )
                how = "values" if unit != "s" else column.how
            return self.read_numbers(column, "t", unit, TIME_UNITS[unit], how)
        # no number: dates, as seconds since 1970
        try:
            dates = pd.to_datetime(raw, errors="coerce", utc=True, format="ISO8601")
        except (ValueError, TypeError, OverflowError):
            dates = pd.Series(pd.NaT, index=raw.index)
        if dates.isna().all():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds neither numbers nor dates such as "
                f"2026-01-31 12:00:00.005; it holds {str(raw.iloc[0])[:40]!r}. Name another with --map t=<column>."
            )
        seconds = (
            (dates - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(dtype=float)
        )
        self.used_columns.append(
            UsedColumn(
                self.recording.file,
                column.name,
                "t",
                "dates",
                "values",
                np.nanmin(seconds),
                np.nanmax(seconds),
            )
        )
        return seconds

    def read_length(self, column: SourceColumn, role: str) -> np.ndarray:
        """A column of lengths [m], or of pixels."""
        unit, how = self.length_unit(column), column.how
        if not column.meaning.unit:
            how = "--unit" if self.hints.unit else how
        if unit == "px":
            return self.read_numbers(column, role, unit, 1.0, how)
        return self.read_numbers(column, role, unit, LENGTH_UNITS[unit], how)

    def length_unit(self, column: SourceColumn) -> str:
        """The unit of a column of lengths: from its name, else as the user gave it for
        the file, else metres.
        """
        said = self.hints.unit
        return (
            column.meaning.unit
            or said.get(self.recording.file.name)
            or said.get("")
            or "m"
        )

    def read_angle(
        self, column: SourceColumn, role: str, beside: Sequence[SourceColumn] = ()
    ) -> np.ndarray:
        """A column of angles [rad]. beside: columns without a unit that are in the same
        one.
        """
        unit, how = column.meaning.unit, column.how
        if not unit and self.hints.degrees is not None:
            unit, how = ("deg", "--deg") if self.hints.degrees else ("rad", "--rad")
        if not unit:
            numbers = self.recording.table[[c.name for c in beside or [column]]].apply(
                pd.to_numeric, errors="coerce"
            )
            # of the one that turns furthest
            turned = float(numbers.abs().quantile(0.9).max())
            unit, how = ("deg", "values") if turned > MAX_ANGLE_RAD else ("rad", how)
        return self.read_numbers(column, role, unit, ANGLE_UNITS[unit], how)

    def read_motion(self, columns: Sequence[SourceColumn]) -> pd.DataFrame | None:
        """Joint angles or poses of the hand, if it holds them."""
        joints = [column for column in columns if column.meaning.kind == "joint"]
        if joints:
            ordered = sorted(joints, key=lambda c: int(c.meaning.name))
            # in degrees all or none
            unsaid = [c for c in ordered if not c.meaning.unit]
            angles = {
                f"q{n}": self.read_angle(column, f"q{n}", unsaid)
                for n, column in enumerate(ordered, 1)
            }
            return pd.DataFrame(angles, index=self.recording.table.index)
        hand = {c.meaning.axis: c for c in columns if c.meaning.kind == "hand"}
        turned = "angle" in hand or {*QUATERNION_AXES} <= {*hand}
        # such a hand is a place that a tracker saw
        if len({"x", "y", "z"} & {*hand}) < 2 or not turned:
            return None
        right, up = self.plane_axes(columns)
        pose = {
            name: axis.sign * self.read_length(hand[axis.name], name)
            for name, axis in (("x", right), ("y", up))
        }
        # the direction in which the string leaves the hand: of a column, or where a
        # quaternion turns x
        if "angle" in hand:
            pose["theta"] = self.read_angle(hand["angle"], "theta")
        else:
            w = {
                name: self.read_numbers(hand[name], name, "1", 1.0, "name")
                for name in QUATERNION_AXES
            }
            axis_of = {
                "x": 1 - 2 * (w["qy"] ** 2 + w["qz"] ** 2),
                "y": 2 * (w["qx"] * w["qy"] + w["qw"] * w["qz"]),
                "z": 2 * (w["qx"] * w["qz"] - w["qw"] * w["qy"]),
            }
            pose["theta"] = np.unwrap(
                np.arctan2(up.sign * axis_of[up.name], right.sign * axis_of[right.name])
            )
        return pd.DataFrame(pose, index=self.recording.table.index)

    def plane_axes(
        self, columns: Sequence[SourceColumn]
    ) -> tuple[PlaneAxis, PlaneAxis]:
        """The directions of x and y: those that are there, or of three those that the
        user gave, or y up.
        """
        if self.hints.plane:
            right, up = (
                PlaneAxis(part.lstrip("-"), -1.0 if part[0] == "-" else 1.0)
                for part in self.hints.plane.split(",")
            )
            return right, up
        there = [
            a
            for a in "xyz"
            if any(
                c.meaning.axis == a
                for c in columns
                if c.meaning.kind in ("hand", "point")
            )
        ]
        if len(there) < 3:
            down = self.hints.y_is_down and any(
                c.meaning.kind == "point" for c in columns
            )
            return PlaneAxis(there[0]), PlaneAxis(there[1], -1.0 if down else 1.0)
        raise DataError(
            f"{self.recording.file}: places have three coordinates, a cast has two. Say which is to the right and "
            "which is up: --plane x,z, or --plane=-z,y where z points to the left."
        )

    def read_points(self, columns: Sequence[SourceColumn]) -> pd.DataFrame | None:
        """Points of the string, a row for each sample of each, if it holds any. Its
        index is that of the samples.
        """
        named: dict[str, dict[str, SourceColumn]] = {}
        for column in columns:
            if column.meaning.kind == "point":
                named.setdefault(column.meaning.name, {})[column.meaning.axis] = column
        arc = next((column for column in columns if column.meaning.kind == "arc"), None)
        placed = {
            name: axes
            for name, axes in named.items()
            if len({"x", "y", "z"} & {*axes}) >= 2
        }
        tables = [
            self._read_point(name, axes, arc, columns) for name, axes in placed.items()
        ]
        return pd.concat(tables) if tables else None

    def _read_point(
        self,
        name: str,
        axes: Mapping[str, SourceColumn],
        arc: SourceColumn | None,
        columns: Sequence[SourceColumn],
    ) -> pd.DataFrame:
        """One point of the string over time."""
        right, up = self.plane_axes(columns)
        role = f"{name}." if name else ""
        xy = {
            axis: way.sign * self.read_length(axes[way.name], f"{role}{axis}")
            for axis, way in (("x", right), ("y", up))
        }
        if self.length_unit(axes[right.name]) == "px":
            scale, origin = self.hints.px_per_m, self.hints.origin_px
            if scale is None or origin is None:
                raise DataError(
                    f"{self.recording.file}: places are in pixels. Say how many are a metre and where the world's "
                    "origin lies in the picture: --px-per-m 340 --origin-px 251.5,387.5."
                )
            # y is counted from the top
            xy = {
                "x": (xy["x"] - origin[0]) / scale,
                "y": (origin[1] - xy["y"]) / scale,
            }
        frame = pd.DataFrame(
            {"point": name, **xy}, index=pd.RangeIndex(len(self.recording.table))
        )
        if arc is not None:
            frame["s"] = self.read_length(arc, "s")
        if "sigma" in axes:
            frame["sigma"] = self.read_length(axes["sigma"], f"{role}sigma")
        if "likelihood" in axes:
            frame["valid"] = (
                self.read_numbers(
                    axes["likelihood"],
                    f"{role}valid",
                    f"> {MIN_LIKELIHOOD}",
                    1.0,
                    "name",
                )
                > MIN_LIKELIHOOD
            )
        elif "valid" in axes:
            frame["valid"] = (
                self.read_numbers(axes["valid"], f"{role}valid", "", 1.0, "name") > 0
            )
        return frame


@dataclass(frozen=True)
class PlaneAxis:
    """A direction of a file, and whether ours is opposite."""

    name: str
    sign: float = 1.0
