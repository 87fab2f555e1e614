"""CSV of OptiTrack's Motive ("Tracking Data Export"): markers and rigid bodies.

The first line holds names and values of the recording. The lines above `Frame,Time
(Seconds)` state for each column its kind (rigid body, marker), its name, and whether it
is a position or a quaternion.
"""

from __future__ import annotations

import csv as lines
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.file_checks import begins_with, check_csv, read_frame
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

FIRST_CELL = "Format Version,"
UNIT_SYMBOLS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm"}
MAX_HEADING_LINES = 12  # at most, before the numbers
RIGID_BODY = "Rigid Body"
# a rigid body's own markers move as it does and are left out
COLUMN_KINDS = (RIGID_BODY, "Marker")
ENCODING = "utf-8-sig"
# Motive's name of a marker that it lost, found again, and did not recognise
UNLABELED = "unlabeled"
# a marker that comes back moved by at most so many times its usual way between the
# frames of its gap, and by less than half the way to any other marker
MAX_RETURN_RATIO = 4.0


def recognises(path: Path) -> bool:
    """Tell whether a file begins as Motive's CSV does."""
    return path.suffix.lower() == ".csv" and begins_with(path, FIRST_CELL, ENCODING)


def read(path: Path) -> list[SourceRecording]:
    """Read positions, and quaternions of rigid bodies, by time, as one recording.

    Raises DataError if the file is damaged.
    """
    with check_csv(path).open(encoding=ENCODING, errors="replace", newline="") as file:
        head = list(islice(lines.reader(file), MAX_HEADING_LINES))
    last = next((n for n, line in enumerate(head) if line[:1] == ["Frame"]), 0)
    above = [line for line in head[1:last] if any(line)]
    if len(above) < 3:
        raise DataError(
            f"{path}: it has no line 'Frame,Time (Seconds),...'. "
            "Export it again, with header and names."
        )
    recording = dict(zip(head[0][::2], head[0][1::2], strict=False))
    rotation = recording.get("Rotation Type", "Quaternion")
    if rotation != "Quaternion":
        raise DataError(
            f"{path}: its rotations are {rotation}. Export it with the type Quaternion."
        )
    unit = UNIT_SYMBOLS.get(recording.get("Length Units", "Meters"), "m")
    axes = head[last]
    frame = read_frame(
        path,
        "Motive's CSV",
        "Export it again.",
        header=None,
        skiprows=last + 1,
        encoding=ENCODING,
        names=range(len(axes)),
    )
    # names that state what a column is: `marker 1 x [m]`, `hand qx`
    columns = {0: "frame", 1: "time [s]"}
    kinds, names, quantities = above[0], above[1], above[-1]
    owners = _marker_names(names)
    for n in range(2, min(len(kinds), len(names), len(quantities), len(axes))):
        name = owners[n]
        axis = axes[n].lower()
        if kinds[n] in COLUMN_KINDS and quantities[n].startswith("Position"):
            owner = "hand " if kinds[n] == RIGID_BODY else ""
            columns[n] = f"{owner}{name} {axis} [{unit}]"
        elif kinds[n] == RIGID_BODY and quantities[n].startswith("Rotation"):
            columns[n] = f"hand {name} q{axis}"
    labels = list(columns.values())
    for label in labels:
        if labels.count(label) > 1:
            raise DataError(
                f"{path}: two markers or bodies have the same name ('{label}'). "
                "Give each a name of its own in Motive, and export it again."
            )
    table = frame[list(columns)].rename(columns=columns)
    table, notes = join_unlabeled(table, f" [{unit}]")
    return [SourceRecording(path, table, notes=tuple(notes))]


def _marker_names(names: Sequence[str]) -> list[str]:
    """Return names without the set of markers before the colon, where they differ."""
    full_names_of: dict[str, set[str]] = {}
    for name in names:
        short = name.rpartition(":")[2] or name
        full_names_of.setdefault(short, set()).add(name)
    shortened = []
    for name in names:
        short = name.rpartition(":")[2] or name
        is_unique = len(full_names_of[short]) == 1
        shortened.append(short if is_unique else name.replace(":", " "))
    return shortened


def join_unlabeled(table: pd.DataFrame, unit: str) -> tuple[pd.DataFrame, list[str]]:
    """Give unlabeled markers back to the marker that was lost meanwhile.

    An unlabeled marker is a labelled one that Motive did not recognise when it came
    back, or a reflection. It is joined to the one marker that it continues, and left
    out if there is none.

    Parameters
    ----------
    table
        Columns such as `tip x [m]` and `Unlabeled 1234 x [m]`.
    unit
        End of the names of coordinates, such as ` [m]`.

    Returns
    -------
    table : pandas.DataFrame
        The table without unlabeled markers, if others have labels.
    notes : list of str
        What became of each unlabeled marker.
    """
    places: dict[str, list[str]] = {}
    for column in table:
        marker, _, axis = str(column).removesuffix(unit).rpartition(" ")
        is_position = axis in ("x", "y", "z") and str(column).endswith(unit)
        if is_position and not marker.startswith("hand "):
            places.setdefault(marker, []).append(str(column))
    lost = [name for name in places if name.lower().startswith(UNLABELED)]
    labelled = [name for name in places if name not in lost]
    if not lost or not labelled:
        return table, []

    table = table.copy()
    notes = []
    for name in sorted(lost, key=lambda marker: _first_row(table, places[marker])):
        there = table[places[name]].notna().all(axis=1).to_numpy()
        count = f"in {there.sum()} of {len(table)} frames"
        owner = _continued_marker(table, places, name, labelled)
        if owner is None:
            notes.append(
                f"the marker {name}, seen {count}, continues no labelled marker and "
                "is left out: a reflection? Label it in Motive if it is none"
            )
        else:
            rows = table.index[there]
            table.loc[rows, places[owner]] = table.loc[rows, places[name]].to_numpy()
            notes.append(
                f"the marker {name}, seen {count}, is taken for {owner}, which was "
                "lost meanwhile. Label it in Motive if it is another"
            )
    unlabeled_columns = [column for name in lost for column in places[name]]
    return table.drop(columns=unlabeled_columns), notes


def _first_row(table: pd.DataFrame, columns: Sequence[str]) -> int:
    return int(table[columns].notna().all(axis=1).to_numpy().argmax())


def _continued_marker(
    table: pd.DataFrame,
    places: dict[str, list[str]],
    name: str,
    labelled: Sequence[str],
) -> str | None:
    """Find the labelled marker that an unlabeled one continues; None if none does."""
    track = table[places[name]].to_numpy(dtype=float)
    rows = np.flatnonzero(np.isfinite(track).all(axis=1))
    if not len(rows):
        return None
    distances = {}
    limits = {}
    for marker in labelled:
        other = table[places[marker]].to_numpy(dtype=float)
        is_seen = np.isfinite(other).all(axis=1)
        seen_rows = np.flatnonzero(is_seen)
        if not len(seen_rows):
            continue
        near = seen_rows[np.argmin(np.abs(seen_rows - rows[0]))]
        distances[marker] = float(np.linalg.norm(track[rows[0]] - other[near]))
        steps = np.linalg.norm(np.diff(other[seen_rows], axis=0), axis=1)
        usual = float(np.quantile(steps, 0.9)) if len(steps) else np.inf
        gap = abs(int(near - rows[0]))
        limits[marker] = MAX_RETURN_RATIO * usual * gap
        if is_seen[rows].any():  # both at once are two markers
            limits[marker] = -1.0
    if not distances:
        return None
    nearest = sorted(distances, key=lambda marker: distances[marker])
    owner = nearest[0]
    is_alone = len(nearest) == 1 or 2 * distances[owner] < distances[nearest[1]]
    return owner if distances[owner] <= limits[owner] and is_alone else None
