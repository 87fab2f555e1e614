"""CSV of OptiTrack's Motive ("Tracking Data Export"): markers and rigid bodies.

The first line holds properties of the recording. The lines above `Frame,Time (Seconds)`
state for each column its kind (rigid body or marker), its name, and its quantity
(position or quaternion).
"""

from __future__ import annotations

import csv as lines
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.file_checks import begins_with, check_csv, read_frame
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

FIRST_CELL = "Format Version,"
UNIT_SYMBOLS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm"}
MAX_HEADING_LINES = 12  # before the numbers
RIGID_BODY = "Rigid Body"
# markers that define a rigid body are left out
COLUMN_KINDS = (RIGID_BODY, "Marker")
ENCODING = "utf-8-sig"
# Motive's name of a marker that reappears without its label
UNLABELED = "unlabeled"
# largest displacement of a marker over a gap, relative to its usual one over so many
# frames; the next marker must be twice as far away
MAX_RETURN_RATIO = 4.0


def recognises(path: Path) -> bool:
    """Return whether a file begins like CSV of Motive."""
    return path.suffix.lower() == ".csv" and begins_with(path, FIRST_CELL, ENCODING)


@dataclass(frozen=True)
class Heading:
    """The lines above the numbers, and how many they are.

    recording: properties such as `Length Units`. kinds, names, quantities, axes: for
    each column rigid body or marker, its name, position or rotation, and x, y, z or w.
    """

    recording: dict[str, str]
    kinds: Sequence[str]
    names: Sequence[str]
    quantities: Sequence[str]
    axes: Sequence[str]
    line_count: int


def read(path: Path) -> list[SourceRecording]:
    """Read positions, and quaternions of rigid bodies, by time, as one recording.

    Raises DataError if the file is damaged.
    """
    heading = read_heading(path)
    rotation = heading.recording.get("Rotation Type", "Quaternion")
    if rotation != "Quaternion":
        raise DataError(
            path,
            f"its rotations are {rotation}",
            "Export it with the type Quaternion.",
        )
    unit = UNIT_SYMBOLS.get(heading.recording.get("Length Units", "Meters"), "m")
    columns = column_labels(heading, unit)
    seen = set()
    for label in columns.values():
        if label in seen:
            raise DataError(
                path,
                f"two markers or bodies have the same name ('{label}')",
                "Give each a name of its own in Motive, and export it again.",
            )
        seen.add(label)
    frame = read_frame(
        path,
        "Motive's CSV",
        "Export it again.",
        header=None,
        skiprows=heading.line_count,
        encoding=ENCODING,
        names=range(len(heading.axes)),
    )
    table = frame[list(columns)].rename(columns=columns)
    table, notes = join_unlabeled(table, f" [{unit}]")
    return [SourceRecording(path, table, notes=tuple(notes))]


def read_heading(path: Path) -> Heading:
    """Read the lines above the numbers; raise DataError if they are missing."""
    with check_csv(path).open(encoding=ENCODING, errors="replace", newline="") as file:
        head = list(islice(lines.reader(file), MAX_HEADING_LINES))
    last = next((n for n, line in enumerate(head) if line[:1] == ["Frame"]), 0)
    above = [line for line in head[1:last] if any(line)]
    if len(above) < 3:
        raise DataError(
            path,
            "it has no line 'Frame,Time (Seconds),...'",
            "Export it again, with header and names.",
        )
    recording = dict(zip(head[0][::2], head[0][1::2], strict=False))
    kinds, names, quantities = above[0], above[1], above[-1]
    return Heading(recording, kinds, names, quantities, head[last], last + 1)


def column_labels(heading: Heading, unit: str) -> dict[int, str]:
    """Return names of positions and quaternions by column number.

    Examples: `marker 1 x [m]`, `hand qx`.
    """
    labels = {0: "frame", 1: "time [s]"}
    owners = _marker_names(heading.names)
    columns = zip(heading.kinds, owners, heading.quantities, heading.axes, strict=False)
    for number, (kind, owner, quantity, axis) in enumerate(columns):
        if number < 2:
            continue
        if kind == RIGID_BODY and quantity.startswith("Rotation"):
            labels[number] = f"hand {owner} q{axis.lower()}"
        elif kind in COLUMN_KINDS and quantity.startswith("Position"):
            prefix = "hand " if kind == RIGID_BODY else ""
            labels[number] = f"{prefix}{owner} {axis.lower()} [{unit}]"
    return labels


def _marker_names(names: Sequence[str]) -> list[str]:
    """Remove the marker set before the colon where the names stay unique."""
    short_names = [name.rpartition(":")[2] or name for name in names]
    full_names_of: dict[str, set[str]] = {}
    for name, short in zip(names, short_names, strict=True):
        full_names_of.setdefault(short, set()).add(name)
    shortened = []
    for name, short in zip(names, short_names, strict=True):
        is_unique = len(full_names_of[short]) == 1
        shortened.append(short if is_unique else name.replace(":", " "))
    return shortened


def join_unlabeled(table: pd.DataFrame, unit: str) -> tuple[pd.DataFrame, list[str]]:
    """Join unlabeled markers to the labelled markers that they continue.

    An unlabeled marker is a labelled one that lost its label while it was hidden, or a
    reflection. Reflections are left out. Columns are such as `tip x [m]`; `unit` is the
    end of their names. Returns the table, and a note about each unlabeled marker.
    """
    columns_of = _position_columns(table, unit)
    lost = [name for name in columns_of if name.lower().startswith(UNLABELED)]
    labelled = [name for name in columns_of if name not in lost]
    if not lost or not labelled:
        return table, []

    tracks = {}  # positions (F, 3) by marker, NaN if not seen
    for name, columns in columns_of.items():
        tracks[name] = table[columns].to_numpy(dtype=float)
    notes = []
    for name in sorted(lost, key=lambda marker: int(is_seen(tracks[marker]).argmax())):
        seen = is_seen(tracks[name])
        if not seen.any():
            continue
        count = f"in {seen.sum()} of {len(table)} frames"
        owner = find_continued(tracks[name], {m: tracks[m] for m in labelled})
        if owner is None:
            notes.append(
                f"the marker {name}, seen {count}, continues no labelled marker and "
                "is left out: a reflection? Label it in Motive if it is none"
            )
        else:
            tracks[owner][seen] = tracks[name][seen]
            notes.append(
                f"the marker {name}, seen {count}, is taken for {owner}, which was "
                "lost meanwhile. Label it in Motive if it is another"
            )
    table = table.drop(columns=[c for name in lost for c in columns_of[name]])
    for name in labelled:
        table[columns_of[name]] = tracks[name]
    return table, notes


def _position_columns(table: pd.DataFrame, unit: str) -> dict[str, list[str]]:
    """Return the columns of each marker's position, by its name."""
    columns_of: dict[str, list[str]] = {}
    for column in map(str, table):
        marker, _, axis = column.removesuffix(unit).rpartition(" ")
        is_position = axis in ("x", "y", "z") and column.endswith(unit)
        if is_position and not marker.startswith("hand "):
            columns_of.setdefault(marker, []).append(column)
    return columns_of


def is_seen(track: np.ndarray) -> np.ndarray:
    """Return the frames in which a marker was seen, (F,) bool."""
    return np.isfinite(track).all(axis=1)


def find_continued(track: np.ndarray, labelled: Mapping[str, np.ndarray]) -> str | None:
    """Find the labelled marker that an unlabeled track (F, 3) [m] continues, if any.

    It is hidden while the other is seen, much nearer to it than the next marker, and
    moves no farther than usual in such a gap. Positions are NaN if not seen.
    """
    rows = np.flatnonzero(is_seen(track))
    distances = {}
    gaps = {}
    for name, other in labelled.items():
        seen_rows = np.flatnonzero(is_seen(other))
        if not len(seen_rows):
            continue
        nearest_row = seen_rows[np.argmin(np.abs(seen_rows - rows[0]))]
        distances[name] = float(np.linalg.norm(track[rows[0]] - other[nearest_row]))
        gaps[name] = abs(int(nearest_row - rows[0]))
    if not distances:
        return None
    owner, *others = sorted(distances, key=lambda name: distances[name])
    if others and 2 * distances[owner] >= distances[others[0]]:
        return None

    seen = is_seen(labelled[owner])
    if seen[rows].any():  # seen at the same time: two markers
        return None
    steps = np.linalg.norm(np.diff(labelled[owner][seen], axis=0), axis=1)
    usual_step = float(np.quantile(steps, 0.9)) if len(steps) else np.inf
    limit = MAX_RETURN_RATIO * usual_step * gaps[owner]
    return owner if distances[owner] <= limit else None
