"""Recordings of arms and trackers as tables of our own format: which column is what, in
which unit, of which trial.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os.path import commonprefix
from pathlib import Path

import pandas as pd

from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import ColumnMeaning, column_meaning, stated_unit
from stringcast.data.importers.reader import (
    ColumnHints,
    RecordingReader,
    SourceColumn,
    UsedColumn,
    list_columns,
    trial_name,
)
from stringcast.data.schema import DataError

MAP_EXPRESSION = re.compile(
    r"(?P<sign>[-+]?)(?P<column>.+?)(?P<shift>[-+]\d+(\.\d+)?)?$"
)
ROLE_PATTERN = re.compile(r"t|trial|s|q\d|x|y|theta|.+\.[xyz]")
ROLE_HELP = "t, trial, q1, q2, q3, x, y, theta (of the hand), s, and <point>.x, <point>.y of the string, as in tip.x"


@dataclass(frozen=True)
class ImportedTables:
    """motion: trial, t [s] and q1, q2 ... [rad] or x, y [m], theta [rad] of the hand.
    points: trial, t [s], point (its name), x, y [m], and s [m], sigma [m], valid where
    files say so. films: by trial. taken: every column that counts. left: columns that
    do not, by file. fps: of films, where their files say so [1/s].
    """

    motion: pd.DataFrame
    points: pd.DataFrame
    films: Mapping[str, Path]
    used_columns: Sequence[UsedColumn]
    unused_columns: Mapping[Path, Sequence[str]]
    fps: float | None = None

    @property
    def joints(self) -> list[str]:
        """Columns of joint angles, base first."""
        return sorted(
            (c for c in self.motion if re.fullmatch(r"q\d+", c)),
            key=lambda c: int(c[1:]),
        )


def gather_tables(
    recordings: Sequence[SourceRecording], hints: ColumnHints
) -> ImportedTables:
    """All recordings together, each trial under one name. Raises DataError where
    something is missing or unclear.
    """
    _refuse_unknown_columns(recordings, hints)
    taken: list[UsedColumn] = []
    left: dict[Path, list[str]] = {}
    moved: list[tuple[SourceRecording, pd.DataFrame]] = []
    seen: list[tuple[SourceRecording, pd.DataFrame]] = []
    for recording in recordings:
        if recording.film is None:
            columns = _interpret_columns(recording, hints)
            motion, points = _read_parts(recording, columns, hints, taken)
            moved += [(recording, motion)] if motion is not None else []
            seen += [(recording, points)] if points is not None else []
            counted = {one.column for one in taken if one.file == recording.file}
            left[recording.file] = [
                name for name in recording.table if name not in counted
            ]
    filmed = [recording for recording in recordings if recording.film is not None]
    if not moved or not (seen or filmed):
        lacking = "no columns say how the hand moved: joint angles, or its place and direction"
        lacking = "no column says where the string was" if moved else lacking
        files = ", ".join(
            dict.fromkeys(str(recording.file) for recording in recordings)
        )
        there = "; ".join(
            f"{recording.file.name}: {list_columns(recording)}"
            for recording in recordings[:3]
        )
        ask = f"Name columns with --map <ours>=<theirs>; ours are {ROLE_HELP}."
        raise DataError(f"{files}: {lacking}. There are {there}. {ask}")
    names = _trial_names([r for r, _ in moved], [r for r, _ in seen] + filmed)
    films = {names[id(r)]: r.film for r in filmed if r.film is not None}
    fps = next((r.fps for r in filmed if r.fps), None)
    # several trials of one file say the same
    unique = {(one.file, one.column, one.role): one for one in taken}
    motion, points = _join_parts(moved, names), _join_parts(seen, names)
    _require_common_trial(
        motion, [*films, *(points["trial"].unique() if len(points) else ())]
    )
    return ImportedTables(motion, points, films, list(unique.values()), left, fps)


def _refuse_unknown_columns(
    recordings: Sequence[SourceRecording], hints: ColumnHints
) -> None:
    """Refuse roles that there are none of, and columns that no file has."""
    there = list(
        dict.fromkeys(str(name) for recording in recordings for name in recording.table)
    )
    for role, text in hints.columns.items():
        if not ROLE_PATTERN.fullmatch(role):
            raise DataError(
                f"--map {role}={text}: '{role}' is no name of ours. Write one of {ROLE_HELP}."
            )
        if not any(_match_column(text, recording) for recording in recordings):
            near = difflib.get_close_matches(text.lstrip("+-"), there, 3) or there[:12]
            raise DataError(
                f"--map {role}={text}: no file has such a column. There are {', '.join(near)}."
            )


def _match_column(
    text: str, recording: SourceRecording
) -> tuple[str, float, float] | None:
    """The column that a text of --map names, its sign, and its shift in the column's
    own unit.
    """
    names = [str(name) for name in recording.table]
    if text in names:
        return text, 1.0, 0.0
    match = MAP_EXPRESSION.match(text)
    assert match is not None
    whole, short = text[len(match["sign"]) :], match["column"]
    sign = -1.0 if match["sign"] == "-" else 1.0
    for name, shift in ((whole, 0.0), (short, float(match["shift"] or 0.0))):
        like = (
            [name]
            if name in names
            else [one for one in names if name.lower() in one.lower()]
        )
        if len(like) == 1:
            return like[0], sign, shift
    return None


def _interpret_columns(
    recording: SourceRecording, hints: ColumnHints
) -> list[SourceColumn]:
    """The columns of a recording that mean something, those first that a person named."""
    asked: dict[str, SourceColumn] = {}
    kinds_of = {
        "t": "time",
        "trial": "trial",
        "s": "arc",
        "x": "hand",
        "y": "hand",
        "theta": "hand",
    }
    for role, text in hints.columns.items():
        if found := _match_column(text, recording):
            name, sign, shift = found
            point, _, axis = role.rpartition(".")
            kind = "point" if point else kinds_of.get(role, "joint")
            axis = "angle" if role == "theta" else "" if kind == "joint" else axis
            said = ColumnMeaning(
                kind, point or role.lstrip("q"), axis, stated_unit(name, kind)
            )
            asked[name] = SourceColumn(name, said, "--map", sign, shift)
    kinds = {(column.meaning.kind, column.meaning.axis) for column in asked.values()}
    own = [
        SourceColumn(str(name), column_meaning(str(name)))
        for name in recording.table
        if str(name) not in asked
    ]
    # who names one joint names all
    if any(kind in ("joint", "hand") for kind, _ in kinds):
        own = [column for column in own if column.meaning.kind not in ("joint", "hand")]
    if any(kind == "point" for kind, _ in kinds):
        own = [
            column
            for column in own
            if column.meaning.kind != "point"
            or column.meaning.axis not in ("x", "y", "z")
        ]
    own = [column for column in own if (column.meaning.kind, "") not in kinds]
    columns = [
        column for column in (*asked.values(), *own) if column.meaning.kind != "other"
    ]
    # nameless x and y beside an angle, without arc lengths, are the hand's
    there = {(column.meaning.kind, column.meaning.axis) for column in columns}
    if (
        ("hand", "angle") in there
        and ("hand", "x") not in there
        and not any(kind == "arc" for kind, _ in there)
    ):
        nameless = [
            c for c in columns if c.meaning.kind == "point" and not c.meaning.name
        ]
        columns = [
            replace(c, meaning=replace(c.meaning, kind="hand")) if c in nameless else c
            for c in columns
        ]
    return columns


def _read_parts(
    recording: SourceRecording,
    columns: Sequence[SourceColumn],
    hints: ColumnHints,
    taken: list[UsedColumn],
) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
    """The hand's motion and the string's points of a recording, in our units; None for
    what it does not hold.
    """
    kinds = {column.meaning.kind for column in columns}
    if not {"joint", "hand", "point"} & kinds:
        return None, None
    reader = RecordingReader(recording, hints, taken)
    about = pd.DataFrame({"t": reader.read_times(columns)}, index=recording.table.index)
    trial = next((column for column in columns if column.meaning.kind == "trial"), None)
    about["trial"] = reader.read_names(trial) if trial else recording.name
    motion = reader.read_motion(columns)
    points = reader.read_points(columns)
    if motion is not None:
        motion = pd.concat([about, motion], axis=1)
    if points is not None:
        late = about["t"].iloc[points.index].to_numpy() + hints.clock
        points = points.assign(
            t=late, trial=about["trial"].iloc[points.index].to_numpy()
        )
    return motion, points


def _trial_names(
    moved: Sequence[SourceRecording], seen: Sequence[SourceRecording]
) -> dict[int, str]:
    """The name of each recording's trial, by the recording's id: its own, or what
    differs in the names of files of the same kind, so that robot_07.csv and
    tracker_07.csv are of one trial.
    """
    names: dict[int, str] = {}
    for group in (moved, seen):
        stems = [recording.name or recording.file.stem for recording in group]
        several = len({*stems}) > 1
        alike = (commonprefix(side) for side in (stems, [stem[::-1] for stem in stems]))  # noqa: RUF071
        # numbers stay whole
        begin, end = (len(same.rstrip("0123456789")) for same in alike)
        for recording, stem in zip(group, stems, strict=True):
            names[id(recording)] = trial_name(
                stem[begin : len(stem) - end] if several else "00"
            )
    return names


def _require_common_trial(motion: pd.DataFrame, seen: Sequence[str]) -> None:
    """Refuse recordings of the hand and of the string that have no trial in common."""
    moved = list(motion["trial"].unique())
    if not {*moved} & {*seen}:
        raise DataError(
            f"The hand's recordings are of the trials {', '.join(moved)}, the string's of {', '.join(seen)}. Call "
            "files of one trial alike, such as robot_07.csv and tracker_07.csv, or give both a column 'trial'."
        )


def _join_parts(
    parts: Sequence[tuple[SourceRecording, pd.DataFrame]], names: Mapping[int, str]
) -> pd.DataFrame:
    """Parts as one table, each row with the name of its trial."""
    named = [
        part.assign(trial=part["trial"].replace("", names[id(recording)]))
        for recording, part in parts
    ]
    return pd.concat(named, ignore_index=True) if named else pd.DataFrame()
