"""Combination of arm and tracker recordings into tables of our format."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from os.path import commonprefix
from pathlib import Path

import pandas as pd

from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import ColumnMeaning, column_meaning, stated_unit
from stringcast.data.importers.hand_motion import (
    find_zero_rows,
    has_direction,
    read_motion,
)
from stringcast.data.importers.pauses import split_at_pauses
from stringcast.data.importers.reader import (
    ONLY_TRIAL,
    ColumnHints,
    RecordingReader,
    SourceColumn,
    UsedColumn,
    list_columns,
    trial_name,
)
from stringcast.data.importers.rests import join_session, split_at_rests
from stringcast.data.importers.string_points import read_points
from stringcast.data.importers.times import read_times
from stringcast.data.schema import DataError

MAP_EXPRESSION = re.compile(
    r"(?P<sign>[-+]?)(?P<column>.+?)(?P<shift>[-+]\d+(\.\d+)?)?$"
)
ROLE_PATTERN = re.compile(r"t|frame|trial|point|s|q\d|x|y|theta|.+\.[xyz]")
ROLE_HELP = (
    "t, frame, trial, q1, q2, q3, x, y, theta (of the hand), s, point (its name), and "
    "<point>.x, <point>.y of the string, as in tip.x"
)
KIND_OF_ROLE = {
    "t": "time",
    "frame": "frame",
    "trial": "trial",
    "point": "label",
    "s": "arc",
    "x": "hand",
    "y": "hand",
    "theta": "hand",
}


@dataclass(frozen=True)
class ImportedTables:
    """Tables of all imported recordings.

    Attributes
    ----------
    motion
        Motion of the hand: trial, t [s] and q1, q2 ... [rad] or x, y [m], theta [rad].
    points
        Points of the string: trial, t [s], point (its name), x, y [m]; s [m], sigma [m]
        and valid if the files have them.
    films
        Video files by trial.
    hints
        The user's description of the files.
    used_columns, unused_columns
        Columns that were read, and others by file.
    notes
        Decisions of the readers.
    zero_rows
        Number of zero rows among others in the hand's log, by file.
    """

    motion: pd.DataFrame
    points: pd.DataFrame
    films: Mapping[str, Path]
    hints: ColumnHints
    used_columns: Sequence[UsedColumn]
    unused_columns: Mapping[Path, Sequence[str]]
    notes: Sequence[str] = ()
    zero_rows: Mapping[Path, int] = field(default_factory=dict)

    @property
    def joints(self) -> list[str]:
        """Names of the columns of joint angles, base first."""
        names = [name for name in self.motion if re.fullmatch(r"q\d+", name)]
        return sorted(names, key=lambda name: int(name[1:]))


@dataclass(frozen=True)
class RecordingParts:
    """The hand's motion and the string's points of one recording, if any, in our units.

    zero_count: number of kept zero rows among others in the motion.
    """

    motion: pd.DataFrame | None = None
    points: pd.DataFrame | None = None
    used_columns: Sequence[UsedColumn] = ()
    zero_count: int = 0


def gather_tables(
    recordings: Sequence[SourceRecording], hints: ColumnHints
) -> ImportedTables:
    """Combine recordings of the hand and of the string, matched by trial.

    The tables are in metres, seconds and radians. Raises DataError if something is
    missing or ambiguous.
    """
    _refuse_unknown_columns(recordings, hints)
    films = [recording for recording in recordings if recording.film is not None]
    parts = []
    for recording in recordings:
        if recording.film is None:
            parts.append((recording, _read_parts(recording, hints)))
    motion_parts = [(r, part.motion) for r, part in parts if part.motion is not None]
    point_parts = [(r, part.points) for r, part in parts if part.points is not None]
    if not motion_parts:
        _refuse_incomplete(
            recordings,
            "no columns say how the hand moved: joint angles, or its place and "
            "direction",
        )
    if not (point_parts or films):
        _refuse_incomplete(recordings, "no column says where the string was")

    names = _trial_names([recording for recording, _ in motion_parts])
    names |= _trial_names([*(recording for recording, _ in point_parts), *films])
    motion = _join_parts(motion_parts, names)
    points = _join_parts(point_parts, names)
    film_of = {names[r]: r.film for r in films if r.film is not None}
    used_columns, unused_columns = _list_used_columns(parts)
    points = _match_leading_zeros(points, motion)
    notes = list(chain.from_iterable(recording.notes for recording in recordings))
    if len(points) and not film_of:
        motion, points = join_session(motion, points)
        motion, points, pauses = split_at_pauses(motion, points)
        motion, points, rests = split_at_rests(motion, points)
        notes += [*pauses, *rests]
    point_trials = points["trial"].unique() if len(points) else ()
    _require_common_trial(motion, [*film_of, *point_trials])
    return ImportedTables(
        motion=motion,
        points=points,
        films=film_of,
        hints=hints,
        used_columns=used_columns,
        unused_columns=unused_columns,
        notes=notes,
        zero_rows=_count_zero_rows(parts),
    )


def _list_used_columns(
    parts: Sequence[tuple[SourceRecording, RecordingParts]],
) -> tuple[list[UsedColumn], dict[Path, list[str]]]:
    """List the used columns, and the unused ones by file.

    Trials of one file share columns.
    """
    used: dict[tuple[Path, str, str], UsedColumn] = {}
    unused = {}
    for recording, part in parts:
        for column in part.used_columns:
            used[column.file, column.column, column.role] = column
        names = {name for file, name, _ in used if file == recording.file}
        others = [str(name) for name in recording.table if name not in names]
        unused[recording.file] = others
    return list(used.values()), unused


def _count_zero_rows(
    parts: Sequence[tuple[SourceRecording, RecordingParts]],
) -> dict[Path, int]:
    """Count the zero rows among others, for each file that has any."""
    counts: Counter[Path] = Counter()
    for recording, part in parts:
        counts[recording.file] += part.zero_count
    return {file: count for file, count in counts.items() if count}


def _refuse_unknown_columns(
    recordings: Sequence[SourceRecording], hints: ColumnHints
) -> None:
    """Refuse unknown roles and missing columns."""
    tables = (recording.table for recording in recordings)
    names = list(dict.fromkeys(map(str, chain.from_iterable(tables))))
    for role, text in hints.columns:
        if not ROLE_PATTERN.fullmatch(role):
            raise DataError(
                f"--map {role}={text}",
                f"'{role}' is no name of ours",
                f"Write one of {ROLE_HELP}.",
            )
        if not any(_match_column(text, recording) for recording in recordings):
            near = difflib.get_close_matches(text.lstrip("+-"), names, 3)
            near = near or names[:12]
            raise DataError(
                f"--map {role}={text}",
                "no file has such a column",
                f"There are {', '.join(near)}.",
            )


def _refuse_incomplete(recordings: Sequence[SourceRecording], fault: str) -> None:
    files = ", ".join(dict.fromkeys(str(recording.file) for recording in recordings))
    columns = "; ".join(f"{r.file.name}: {list_columns(r)}" for r in recordings[:3])
    raise DataError(
        files,
        fault,
        f"There are {columns}. Name columns with --map <ours>=<theirs>; ours are "
        f"{ROLE_HELP}.",
    )


def _match_column(
    text: str, recording: SourceRecording
) -> tuple[str, float, float] | None:
    """Find the column for an argument of --map.

    Returns its name, its sign, and its shift in the column's unit.
    """
    names = [str(name) for name in recording.table]
    if text in names:
        return text, 1.0, 0.0
    match = MAP_EXPRESSION.match(text)
    assert match is not None
    sign = -1.0 if match["sign"] == "-" else 1.0
    unsigned = text[len(match["sign"]) :]
    for name, shift in ((unsigned, 0.0), (match["column"], float(match["shift"] or 0))):
        if name in names:
            return name, sign, shift
        similar = [known for known in names if name.lower() in known.lower()]
        if len(similar) == 1:
            return similar[0], sign, shift
    return None


def _interpret_columns(
    recording: SourceRecording, hints: ColumnHints
) -> list[SourceColumn]:
    """Interpret the columns of a recording; mappings of the user take precedence."""
    mapped = _mapped_columns(recording, hints)
    mapped_kinds = _kinds_and_axes(mapped.values())
    kinds = {kind for kind, _ in mapped_kinds}
    columns = list(mapped.values())
    for name in map(str, recording.table):
        if name in mapped:
            continue
        meaning = column_meaning(name)
        is_motion = meaning.kind in ("joint", "hand")
        is_position = meaning.kind == "point" and meaning.axis in ("x", "y", "z")
        # mapping one joint or point requires mapping all of them
        is_replaced = (
            (is_motion and not kinds.isdisjoint(("joint", "hand")))
            or (is_position and "point" in kinds)
            or (meaning.kind, "") in mapped_kinds
        )
        if meaning.kind != "other" and not is_replaced:
            columns.append(SourceColumn(name, meaning))
    # unnamed x and y belong to the hand if it has a direction and no row an arc length
    all_kinds = _kinds_and_axes(columns)
    hand_axes = {axis for kind, axis in all_kinds if kind == "hand"}
    has_arc = any(kind == "arc" for kind, _ in all_kinds)
    if has_direction(hand_axes) and "x" not in hand_axes and not has_arc:
        for n, column in enumerate(columns):
            if column.meaning.kind == "point" and not column.meaning.name:
                meaning = replace(column.meaning, kind="hand")
                columns[n] = replace(column, meaning=meaning)
    return columns


def _kinds_and_axes(columns: Iterable[SourceColumn]) -> set[tuple[str, str]]:
    return {(column.meaning.kind, column.meaning.axis) for column in columns}


def _mapped_columns(
    recording: SourceRecording, hints: ColumnHints
) -> dict[str, SourceColumn]:
    """Interpret the columns that the user mapped."""
    by_role = {}
    for role, text in hints.columns:
        match = _match_column(text, recording)
        if match is None:
            continue
        name, sign, shift = match
        point, _, axis = role.rpartition(".")
        kind = "point" if point else KIND_OF_ROLE.get(role, "joint")
        if role == "theta":
            axis = "angle"
        elif kind == "joint":
            axis = ""
        meaning = ColumnMeaning(
            kind, point or role.lstrip("q"), axis, stated_unit(name, kind)
        )
        by_role[role] = SourceColumn(name, meaning, "--map", sign, shift)
    return {column.name: column for column in by_role.values()}


def _read_parts(recording: SourceRecording, hints: ColumnHints) -> RecordingParts:
    """Read the hand's motion and the string's points of a recording."""
    columns = _interpret_columns(recording, hints)
    kinds = {column.meaning.kind for column in columns}
    if kinds.isdisjoint(("joint", "hand", "point")):
        return RecordingParts()
    reader = RecordingReader(recording, hints, columns)
    common = pd.DataFrame({"t": read_times(reader)})
    trials = reader.columns_of("trial")
    common["trial"] = recording.name
    if trials:
        common["trial"] = reader.read_names(trials[0], "trial").map(trial_name)
    motion = read_motion(reader)
    points = read_points(reader)
    zero_count = 0
    if motion is not None:
        motion = pd.concat([common, motion], axis=1)
        is_zero = find_zero_rows(reader)
        if hints.skip_zeros:
            motion = motion[~is_zero]
        else:
            zero_count = int(is_zero.sum())
    if points is not None:
        rows = common.iloc[points.index]
        times = rows["t"].to_numpy() + hints.clock
        points = points.assign(t=times, trial=rows["trial"].to_numpy())
    return RecordingParts(motion, points, reader.used_columns, zero_count)


def _trial_names(
    recordings: Sequence[SourceRecording],
) -> dict[SourceRecording, str]:
    """Name the trials of recordings of one kind.

    The name is the differing part of the file names: robot_07.csv and tracker_07.csv
    belong to trial t07.
    """
    stems = [recording.name or recording.file.stem for recording in recordings]
    if len({*stems}) < 2:
        return dict.fromkeys(recordings, ONLY_TRIAL)
    # do not cut numbers
    prefix = commonprefix(stems).rstrip("0123456789")  # noqa: RUF071
    reversed_stems = [stem[::-1] for stem in stems]
    suffix = commonprefix(reversed_stems)[::-1]  # noqa: RUF071
    # the common suffix of drive_a and release_a is _a, not e_a
    # and that of film_1DLC_resnet50 and film_2DLC_resnet50 begins at DLC
    ends = [stem[: len(stem) - len(suffix)][-1:] for stem in stems]
    if not (suffix[:1].isalpha() and all(end.isdigit() for end in ends)):
        suffix = re.sub("^[A-Za-z0-9]*", "", suffix)
    names = {}
    for recording, stem in zip(recordings, stems, strict=True):
        name = stem[len(prefix) : len(stem) - len(suffix)]
        names[recording] = trial_name(name)
    return names


def _match_leading_zeros(points: pd.DataFrame, motion: pd.DataFrame) -> pd.DataFrame:
    """Name the trials of points as those of the hand if only leading zeros differ."""
    if points.empty or {*points["trial"]} & {*motion["trial"]}:
        return points
    names_of_number: dict[str, set[str]] = {}
    for name in motion["trial"].unique():
        names_of_number.setdefault(_without_zeros(name), set()).add(name)
    new_names = {}
    for name in points["trial"].unique():
        names = names_of_number.get(_without_zeros(name), set())
        new_names[name] = min(names) if len(names) == 1 else name
    if len({*new_names.values()}) < len(new_names):
        return points
    return points.assign(trial=points["trial"].map(new_names))


def _without_zeros(trial: str) -> str:
    return re.sub(r"(?<!\d)0+(?=\d)", "", trial)


def _require_common_trial(motion: pd.DataFrame, filmed: Sequence[str]) -> None:
    """Refuse hand and string recordings without a common trial."""
    performed = list(motion["trial"].unique())
    if not {*performed} & {*filmed}:
        raise DataError(
            "",
            f"The hand was recorded in the trials {', '.join(performed)}, the "
            f"string in {', '.join(filmed)}",
            "Give files of one trial the same ending, such as robot_07.csv and "
            "tracker_07.csv, or give both a column 'trial'.",
        )


def _join_parts(
    parts: Sequence[tuple[SourceRecording, pd.DataFrame]],
    names: Mapping[SourceRecording, str],
) -> pd.DataFrame:
    """Join parts to one table with a column of trial names."""
    if not parts:
        return pd.DataFrame()
    frames = []
    for recording, part in parts:
        trial = part["trial"].replace("", names[recording])
        frames.append(part.assign(trial=trial))
    return pd.concat(frames, ignore_index=True)
