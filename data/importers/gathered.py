"""Recordings of arms and trackers as tables of our own format: which column is what, in which unit, of which trial."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os.path import commonprefix
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.importers.columns import ANGLES, LENGTHS, QUATERNION, TIMES, Meaning, meaning, unit_in
from stringcast.data.importers.recording import Recording
from stringcast.data.schema import DataError

STEP = 0.5  # [s] between samples at most: from longer ones no motion can be told, so that they count in a smaller unit
TURNED = 4 * np.pi  # [rad] further no joint turns: larger angles are in degrees
LIKELY = 0.6  # of a tracker's own likelihood: below it says that it guesses (DeepLabCut's pcutoff)
EXPRESSION = re.compile(r"(?P<sign>[-+]?)(?P<column>.+?)(?P<shift>[-+]\d+(\.\d+)?)?$")
ROLES = re.compile(r"t|trial|s|q\d|x|y|theta|.+\.[xyz]")
ROLES_ARE = "t, trial, q1, q2, q3, x, y, theta (of the hand), s, and <point>.x, <point>.y of the string, as in tip.x"


@dataclass(frozen=True)
class Said:
    """What a person says of the files, beside what their columns' names do.

    columns: our name to theirs, with a sign before it and a shift behind it, as in q2: -elbow_deg+90. unit: of
    lengths, by the file's name, or of all under the empty name; likewise degrees. down: y points down. plane: which
    two of three directions are x and y, each with a sign. fps: of files without times. clock: to be added to the times
    of points [s]. px_per_m, origin: of pixels. at: arc lengths of named points [m].
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: Mapping[str, str] = field(default_factory=dict)
    degrees: bool | None = None
    down: bool = False
    plane: str = ""
    fps: float | None = None
    clock: float = 0.0
    px_per_m: float | None = None
    origin_px: tuple[float, float] | None = None


@dataclass(frozen=True)
class Taken:
    """A column as it was understood. role: as what. unit: in which it is. how: by name, by its values, or as was said.
    low, high: of its numbers, in our units."""

    file: Path
    column: str
    role: str
    unit: str
    how: str
    low: float = np.nan
    high: float = np.nan


@dataclass(frozen=True)
class Gathered:
    """motion: trial, t [s] and q1, q2 ... [rad] or x, y [m], theta [rad] of the hand. points: trial, t [s], point (its
    name), x, y [m], and s [m], sigma [m], valid where files say so. films: by trial. taken: every column that counts.
    left: columns that do not, by file. fps: of films, where their files say so [1/s]."""

    motion: pd.DataFrame
    points: pd.DataFrame
    films: Mapping[str, Path]
    taken: Sequence[Taken]
    left: Mapping[Path, Sequence[str]]
    fps: float | None = None

    @property
    def joints(self) -> list[str]:
        """Columns of joint angles, base first."""
        return sorted((c for c in self.motion if re.fullmatch(r"q\d+", c)), key=lambda c: int(c[1:]))


@dataclass(frozen=True)
class _Column:
    """One column on its way: its role, unit, sign, and shift in its own unit."""

    name: str
    meaning: Meaning
    how: str = "name"
    sign: float = 1.0
    shift: float = 0.0


def gathered(recordings: Sequence[Recording], said: Said) -> Gathered:
    """All recordings together, each trial under one name. Raises DataError where something is missing or unclear."""
    _refuse_unknown(recordings, said)
    taken: list[Taken] = []
    left: dict[Path, list[str]] = {}
    moved: list[tuple[Recording, pd.DataFrame]] = []
    seen: list[tuple[Recording, pd.DataFrame]] = []
    for recording in recordings:
        if recording.film is None:
            columns = _columns(recording, said)
            motion, points = _parts(recording, columns, said, taken)
            moved += [(recording, motion)] if motion is not None else []
            seen += [(recording, points)] if points is not None else []
            counted = {one.column for one in taken if one.file == recording.file}
            left[recording.file] = [name for name in recording.table if name not in counted]
    filmed = [recording for recording in recordings if recording.film is not None]
    if not moved:
        raise DataError(
            f"{_files(recordings)}: no columns say how the hand moved: joint angles, or its place and "
            f"direction. {_what_there_is(recordings)}"
        )
    if not seen and not filmed:
        raise DataError(f"{_files(recordings)}: no column says where the string was. {_what_there_is(recordings)}")
    names = _trials([r for r, _ in moved], [r for r, _ in seen] + filmed)
    films = {names[id(r)]: r.film for r in filmed if r.film is not None}
    fps = next((r.fps for r in filmed if r.fps), None)
    unique = {(one.file, one.column, one.role): one for one in taken}  # several trials of one file say the same
    motion, points = _whole(moved, names), _whole(seen, names)
    _refuse_strangers(motion, [*films, *(points["trial"].unique() if len(points) else ())])
    return Gathered(motion, points, films, list(unique.values()), left, fps)


def _refuse_unknown(recordings: Sequence[Recording], said: Said) -> None:
    """Refuse roles that there are none of, and columns that no file has."""
    there = list(dict.fromkeys(str(name) for recording in recordings for name in recording.table))
    for role, text in said.columns.items():
        if not ROLES.fullmatch(role):
            raise DataError(f"--map {role}={text}: '{role}' is no name of ours. Write one of {ROLES_ARE}.")
        if not any(_found(text, recording) for recording in recordings):
            near = difflib.get_close_matches(text.lstrip("+-"), there, 3) or there[:12]
            raise DataError(f"--map {role}={text}: no file has such a column. There are {', '.join(near)}.")


def _found(text: str, recording: Recording) -> tuple[str, float, float] | None:
    """The column that a text of --map names, its sign, and its shift in the column's own unit."""
    names = [str(name) for name in recording.table]
    if text in names:
        return text, 1.0, 0.0
    match = EXPRESSION.match(text)
    assert match is not None
    whole, short = text[len(match["sign"]) :], match["column"]
    sign = -1.0 if match["sign"] == "-" else 1.0
    for name, shift in ((whole, 0.0), (short, float(match["shift"] or 0.0))):
        like = [name] if name in names else [one for one in names if name.lower() in one.lower()]
        if len(like) == 1:
            return like[0], sign, shift
    return None


def _columns(recording: Recording, said: Said) -> list[_Column]:
    """The columns of a recording that mean something, those first that a person named."""
    asked: dict[str, _Column] = {}
    for role, text in said.columns.items():
        found = _found(text, recording)
        if found:
            name, sign, shift = found
            asked[name] = _Column(name, _as_said(role, name), "--map", sign, shift)
    kinds = {(column.meaning.kind, column.meaning.axis) for column in asked.values()}
    own = [_Column(str(name), meaning(str(name))) for name in recording.table if str(name) not in asked]
    if any(kind in ("joint", "hand") for kind, _ in kinds):  # who names one joint names all
        own = [column for column in own if column.meaning.kind not in ("joint", "hand")]
    if any(kind == "point" for kind, _ in kinds):
        own = [column for column in own if column.meaning.kind != "point" or column.meaning.axis not in ("x", "y", "z")]
    own = [column for column in own if (column.meaning.kind, "") not in kinds]
    columns = [column for column in (*asked.values(), *own) if column.meaning.kind != "other"]
    return _hand_by_its_angle(columns)


def _as_said(role: str, column: str) -> Meaning:
    """What a column of a role of ours is; its unit is the one that its name says."""
    point, _, axis = role.rpartition(".")
    kinds = {"t": "time", "trial": "trial", "s": "arc", "x": "hand", "y": "hand", "theta": "hand"}
    kind = "point" if point else kinds.get(role, "joint")
    axis = "angle" if role == "theta" else "" if kind == "joint" else axis
    return Meaning(kind, point or role.lstrip("q"), axis, unit_in(column, kind))


def _hand_by_its_angle(columns: Sequence[_Column]) -> list[_Column]:
    """Nameless x and y beside an angle, without arc lengths, are the hand's."""
    kinds = {column.meaning.kind for column in columns}
    angle = any(column.meaning.kind == "hand" and column.meaning.axis == "angle" for column in columns)
    placed = any(column.meaning.kind == "hand" and column.meaning.axis == "x" for column in columns)
    if not angle or placed or "arc" in kinds:
        return list(columns)
    nameless = [c for c in columns if c.meaning.kind == "point" and not c.meaning.name]
    return [replace(c, meaning=replace(c.meaning, kind="hand")) if c in nameless else c for c in columns]


def _parts(
    recording: Recording, columns: Sequence[_Column], said: Said, taken: list[Taken]
) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
    """What a recording says of the hand and of the string, in our units; None of what it says nothing."""
    kinds = {column.meaning.kind for column in columns}
    if not {"joint", "hand", "point"} & kinds:
        return None, None
    reader = _Reader(recording, said, taken)
    about = pd.DataFrame({"t": reader.times(columns)}, index=recording.table.index)
    trial = next((column for column in columns if column.meaning.kind == "trial"), None)
    about["trial"] = reader.names(trial) if trial else recording.name
    motion = reader.motion(columns)
    points = reader.points(columns)
    if motion is not None:
        motion = pd.concat([about, motion], axis=1)
    if points is not None:
        late = about["t"].iloc[points.index].to_numpy() + said.clock
        points = points.assign(t=late, trial=about["trial"].iloc[points.index].to_numpy())
    return motion, points


@dataclass(frozen=True)
class _Reader:
    """Turns columns of a recording into numbers of ours, and notes how each was taken."""

    recording: Recording
    said: Said
    taken: list[Taken]

    def numbers(self, column: _Column, role: str, unit: str, factor: float, how: str) -> np.ndarray:
        """A column [our unit]; raises DataError where it holds no number."""
        raw = pd.to_numeric(self.recording.table[column.name], errors="coerce").to_numpy(dtype=float)
        values = (column.sign * raw + column.shift) * factor
        if not np.isfinite(values).any():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds no number. Correct it, or name another with "
                f"--map {role}=<column>."
            )
        self.taken.append(
            Taken(self.recording.file, column.name, role, unit, how, float(np.nanmin(values)), float(np.nanmax(values)))
        )
        return values

    def names(self, column: _Column) -> np.ndarray:
        """Names of trials."""
        self.taken.append(Taken(self.recording.file, column.name, "trial", "", column.how))
        return self.recording.table[column.name].astype(str).map(_named).to_numpy()

    def times(self, columns: Sequence[_Column]) -> np.ndarray:
        """Times [s]: of the best column of times, or of the frames' numbers."""
        found = [column for column in columns if column.meaning.kind == "time"]
        if found:
            column = min(found, key=lambda c: (c.how != "--map", len(c.meaning.name.split())))
            return self._clock(column)
        fps = self.said.fps or self.recording.fps
        if fps is None:
            raise DataError(
                f"{self.recording.file}: no column holds times; there are {_listed(self.recording)}. Name it with "
                "--map t=<column>, or give the camera's rate with --fps 200."
            )
        frame = next((column for column in columns if column.meaning.kind == "frame"), None)
        if frame is None:
            return np.arange(len(self.recording.table)) / fps
        return self.numbers(frame, "t", f"frames, {fps:g} a second", 1 / fps, "--fps" if self.said.fps else "file")

    def _clock(self, column: _Column) -> np.ndarray:
        """A column of times [s]: numbers in the unit that its name says or its steps tell, or dates."""
        raw = self.recording.table[column.name]
        numbers = pd.to_numeric(raw, errors="coerce")
        if numbers.notna().sum() == 0:
            return self._dates(column, raw)
        unit, how = column.meaning.unit, column.how
        if not unit:
            steps = np.diff(np.unique(numbers.dropna()))
            usual = float(np.median(steps)) if len(steps) else 0.0
            unit = next((u for u in ("s", "ms", "us", "ns") if usual * TIMES[u] < STEP), "s")
            how = "values" if unit != "s" else column.how
        return self.numbers(column, "t", unit, TIMES[unit], how)

    def _dates(self, column: _Column, raw: pd.Series) -> np.ndarray:
        """A column of dates, as seconds since 1970."""
        try:
            dates = pd.to_datetime(raw, errors="coerce", utc=True, format="ISO8601")
        except (ValueError, TypeError, OverflowError):
            dates = pd.Series(pd.NaT, index=raw.index)
        if dates.isna().all():
            raise DataError(
                f"{self.recording.file}: column '{column.name}' holds neither numbers nor dates such as "
                f"2026-01-31 12:00:00.005; it holds {str(raw.iloc[0])[:40]!r}. Name another with --map t=<column>."
            )
        seconds = (dates - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(dtype=float)
        self.taken.append(
            Taken(self.recording.file, column.name, "t", "dates", "values", np.nanmin(seconds), np.nanmax(seconds))
        )
        return seconds

    def length(self, column: _Column, role: str) -> np.ndarray:
        """A column of lengths [m], or of pixels."""
        unit, how = self.unit(column), column.how
        if not column.meaning.unit:
            how = "--unit" if self.said.unit else how
        if unit == "px":
            return self.numbers(column, role, unit, 1.0, how)
        return self.numbers(column, role, unit, LENGTHS[unit], how)

    def unit(self, column: _Column) -> str:
        """Of a column of lengths: as its name says, or a person does of its file, or metres."""
        said = self.said.unit
        return column.meaning.unit or said.get(self.recording.file.name) or said.get("") or "m"

    def angle(self, column: _Column, role: str) -> np.ndarray:
        """A column of angles [rad]."""
        unit, how = column.meaning.unit, column.how
        if not unit and self.said.degrees is not None:
            unit, how = ("deg" if self.said.degrees else "rad"), "--deg" if self.said.degrees else "--rad"
        if not unit:
            raw = np.abs(pd.to_numeric(self.recording.table[column.name], errors="coerce").to_numpy(dtype=float))
            far = float(np.nanquantile(raw, 0.9)) if np.isfinite(raw).any() else 0.0
            unit, how = ("deg", "values") if far > TURNED else ("rad", how)
        return self.numbers(column, role, unit, ANGLES[unit], how)

    def motion(self, columns: Sequence[_Column]) -> pd.DataFrame | None:
        """Joint angles or poses of the hand, if it holds them."""
        joints = [column for column in columns if column.meaning.kind == "joint"]
        if joints:
            ordered = sorted(joints, key=lambda c: int(c.meaning.name))
            degrees = [c for c in ordered if not c.meaning.unit]  # in degrees all or none
            reader = self if not degrees else replace(self, said=self._degrees_of(degrees))
            angles = {f"q{n}": reader.angle(column, f"q{n}") for n, column in enumerate(ordered, 1)}
            return pd.DataFrame(angles, index=self.recording.table.index)
        hand = {c.meaning.axis: c for c in columns if c.meaning.kind == "hand"}
        turned = "angle" in hand or {*QUATERNION} <= {*hand}
        if len({"x", "y", "z"} & {*hand}) < 2 or not turned:  # such a hand is a place that a tracker saw
            return None
        right, up = self.plane(columns)
        places = {name: axis.sign * self.length(hand[axis.name], name) for name, axis in (("x", right), ("y", up))}
        return pd.DataFrame({**places, "theta": self._theta(hand, right, up)}, index=self.recording.table.index)

    def _degrees_of(self, columns: Sequence[_Column]) -> Said:
        """What is said, with degrees for all of these if one of them turns so far."""
        if self.said.degrees is not None:
            return self.said
        raw = self.recording.table[[c.name for c in columns]].apply(pd.to_numeric, errors="coerce").abs()
        return replace(self.said, degrees=True) if float(raw.quantile(0.9).max()) > TURNED else self.said

    def _theta(self, hand: Mapping[str, _Column], right: _Axis, up: _Axis) -> np.ndarray:
        """Direction in which the string leaves the hand [rad]: of a column, or where a quaternion turns x."""
        if "angle" in hand:
            return self.angle(hand["angle"], "theta")
        w = {name: self.numbers(hand[name], name, "1", 1.0, "name") for name in QUATERNION}
        axis = {
            "x": 1 - 2 * (w["qy"] ** 2 + w["qz"] ** 2),
            "y": 2 * (w["qx"] * w["qy"] + w["qw"] * w["qz"]),
            "z": 2 * (w["qx"] * w["qz"] - w["qw"] * w["qy"]),
        }
        return np.unwrap(np.arctan2(up.sign * axis[up.name], right.sign * axis[right.name]))

    def plane(self, columns: Sequence[_Column]) -> tuple[_Axis, _Axis]:
        """Which of the directions are ours: those that are there, or of three those that were said or y up."""
        if self.said.plane:
            right, up = (
                _Axis(part.lstrip("-"), -1.0 if part[0] == "-" else 1.0) for part in self.said.plane.split(",")
            )
            return right, up
        there = [a for a in "xyz" if any(c.meaning.axis == a for c in columns if c.meaning.kind in ("hand", "point"))]
        if len(there) < 3:
            down = self.said.down and any(c.meaning.kind == "point" for c in columns)
            return _Axis(there[0]), _Axis(there[1], -1.0 if down else 1.0)
        raise DataError(
            f"{self.recording.file}: places have three coordinates, a cast has two. Say which is to the right and "
            "which is up: --plane x,z, or --plane=-z,y where z points to the left."
        )

    def points(self, columns: Sequence[_Column]) -> pd.DataFrame | None:
        """Points of the string, a row for each sample of each, if it holds any. Its index is that of the samples."""
        named: dict[str, dict[str, _Column]] = {}
        for column in columns:
            if column.meaning.kind == "point":
                named.setdefault(column.meaning.name, {})[column.meaning.axis] = column
        arc = next((column for column in columns if column.meaning.kind == "arc"), None)
        placed = {name: axes for name, axes in named.items() if len({"x", "y", "z"} & {*axes}) >= 2}
        tables = [self._point(name, axes, arc, columns) for name, axes in placed.items()]
        return pd.concat(tables) if tables else None

    def _point(
        self, name: str, axes: Mapping[str, _Column], arc: _Column | None, columns: Sequence[_Column]
    ) -> pd.DataFrame:
        """One point of the string over time."""
        right, up = self.plane(columns)
        role = f"{name}." if name else ""
        xy = {axis: way.sign * self.length(axes[way.name], f"{role}{axis}") for axis, way in (("x", right), ("y", up))}
        if self.unit(axes[right.name]) == "px":
            xy = self._on_the_plane(xy)
        frame = pd.DataFrame({"point": name, **xy}, index=pd.RangeIndex(len(self.recording.table)))
        if arc is not None:
            frame["s"] = self.length(arc, "s")
        if "sigma" in axes:
            frame["sigma"] = self.length(axes["sigma"], f"{role}sigma")
        if "likelihood" in axes:
            frame["valid"] = self.numbers(axes["likelihood"], f"{role}valid", f"> {LIKELY}", 1.0, "name") > LIKELY
        elif "valid" in axes:
            frame["valid"] = self.numbers(axes["valid"], f"{role}valid", "", 1.0, "name") > 0
        return frame

    def _on_the_plane(self, xy: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Pixels, counted down from the top, as metres."""
        scale, origin = self.said.px_per_m, self.said.origin_px
        if scale is None or origin is None:
            raise DataError(
                f"{self.recording.file}: places are in pixels. Say how many are a metre and where the world's origin "
                "lies in the picture: --px-per-m 340 --origin-px 251.5,387.5."
            )
        return {"x": (xy["x"] - origin[0]) / scale, "y": (origin[1] - xy["y"]) / scale}


@dataclass(frozen=True)
class _Axis:
    """A direction of a file, and whether ours is opposite."""

    name: str
    sign: float = 1.0


def _trials(moved: Sequence[Recording], seen: Sequence[Recording]) -> dict[int, str]:
    """The name of each recording's trial, by the recording's id: its own, or what differs in the names of files of the
    same kind, so that robot_07.csv and tracker_07.csv are of one trial."""
    names: dict[int, str] = {}
    for group in (moved, seen):
        stems = [recording.name or recording.file.stem for recording in group]
        several = len({*stems}) > 1
        begin, end = (_alike(side) if several else 0 for side in (stems, [stem[::-1] for stem in stems]))
        for recording, stem in zip(group, stems, strict=True):
            names[id(recording)] = _named(stem[begin : len(stem) - end] if several else "00")
    return names


def _alike(names: Sequence[str]) -> int:
    """With how many characters names begin alike, numbers left whole."""
    return len(commonprefix(names).rstrip("0123456789"))  # noqa: RUF071


def _named(key: str) -> str:
    """A trial's name of what distinguishes it: numbers alone are no names."""
    return f"t{key}" if key.isdigit() else key


def _refuse_strangers(motion: pd.DataFrame, seen: Sequence[str]) -> None:
    """Refuse recordings of the hand and of the string that have no trial in common."""
    moved = list(motion["trial"].unique())
    if not {*moved} & {*seen}:
        raise DataError(
            f"The hand's recordings are of the trials {', '.join(moved)}, the string's of {', '.join(seen)}. Call "
            "files of one trial alike, such as robot_07.csv and tracker_07.csv, or give both a column 'trial'."
        )


def _whole(parts: Sequence[tuple[Recording, pd.DataFrame]], names: Mapping[int, str]) -> pd.DataFrame:
    """Parts as one table, each row with the name of its trial."""
    named = [part.assign(trial=part["trial"].replace("", names[id(recording)])) for recording, part in parts]
    return pd.concat(named, ignore_index=True) if named else pd.DataFrame()


def _files(recordings: Sequence[Recording]) -> str:
    return ", ".join(dict.fromkeys(str(recording.file) for recording in recordings))


def _listed(recording: Recording) -> str:
    names = [str(name) for name in recording.table]
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "") if names else "none"


def _what_there_is(recordings: Sequence[Recording]) -> str:
    there = "; ".join(f"{recording.file.name}: {_listed(recording)}" for recording in recordings[:3])
    return f"There are {there}. Name columns with --map <ours>=<theirs>; ours are {ROLES_ARE}."
