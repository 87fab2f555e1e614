"""OptiTrack's CSV (Motive, "Tracking Data Export"): markers and rigid bodies with
times.

Its first line holds names and values of the recording. The lines above `Frame,Time
(Seconds)` say of each column what it is of (rigid body, marker), its name, and whether
it is a place or a quaternion.
"""

from __future__ import annotations

import csv as lines
from pathlib import Path

import pandas as pd

from stringcast.data.file_checks import check_csv
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

FIRST_CELL = "Format Version,"
UNIT_SYMBOLS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm"}
MAX_HEADING_LINES = 12  # at most, before the numbers
RIGID_BODY = "Rigid Body"
# columns that count: a rigid body's own markers move as it does
COLUMN_KINDS = (RIGID_BODY, "Marker")


def reads(path: Path) -> bool:
    """Whether a file begins as Motive's CSV does."""
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return file.read(len(FIRST_CELL)) == FIRST_CELL


def read(path: Path) -> list[SourceRecording]:
    """Places, and quaternions of rigid bodies, by time: one recording. Raises DataError
    where it is damaged.
    """
    with check_csv(path).open(
        encoding="utf-8-sig", errors="replace", newline=""
    ) as file:
        head = [
            line
            for _, line in zip(
                range(MAX_HEADING_LINES), lines.reader(file), strict=False
            )
        ]
    last = next((n for n, line in enumerate(head) if line[:1] == ["Frame"]), None)
    above = [line for line in head[1 : last or 0] if any(line)]
    if last is None or len(above) < 3:
        raise DataError(
            f"{path}: it has no line 'Frame,Time (Seconds),...'. Export it again, with header and names."
        )
    about = dict(zip(head[0][::2], head[0][1::2], strict=False))
    if about.get("Rotation Type", "Quaternion") != "Quaternion":
        raise DataError(
            f"{path}: its rotations are {about['Rotation Type']}. Export it with the type Quaternion."
        )
    kinds, names, places = above[0], above[1], above[-1]
    unit = UNIT_SYMBOLS.get(about.get("Length Units", "Meters"), "m")
    try:
        frame = pd.read_csv(
            path,
            header=None,
            skiprows=last + 1,
            encoding="utf-8-sig",
            names=range(len(head[last])),
        )
    except (ValueError, OSError) as error:
        raise DataError(
            f"{path}: cannot be read as Motive's CSV ({error}). Export it again."
        ) from error
    # and names that say what a column is: `marker 1 x [m]`, `hand qx`
    kept = {0: "frame", 1: "time [s]"}
    for n, (kind, name, place, axis) in enumerate(
        zip(kinds, names, places, head[last], strict=False)
    ):
        short = name.rpartition(":")[2] or name
        if n > 1 and kind in COLUMN_KINDS and place.startswith("Position"):
            kept[n] = (
                f"{'hand ' if kind == RIGID_BODY else ''}{short} {axis.lower()} [{unit}]"
            )
        elif n > 1 and kind == RIGID_BODY and place.startswith("Rotation"):
            kept[n] = f"hand {short} q{axis.lower()}"
    return [SourceRecording(path, frame[list(kept)].rename(columns=kept))]
