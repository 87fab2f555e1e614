"""CSV of OptiTrack's Motive ("Tracking Data Export"): markers and rigid bodies.

The first line holds names and values of the recording. The lines above `Frame,Time
(Seconds)` state for each column its kind (rigid body, marker), its name, and whether it
is a position or a quaternion.
"""

from __future__ import annotations

import csv as lines
from itertools import islice
from pathlib import Path

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
    for n in range(2, min(len(kinds), len(names), len(quantities), len(axes))):
        name = names[n].rpartition(":")[2] or names[n]
        axis = axes[n].lower()
        if kinds[n] in COLUMN_KINDS and quantities[n].startswith("Position"):
            owner = "hand " if kinds[n] == RIGID_BODY else ""
            columns[n] = f"{owner}{name} {axis} [{unit}]"
        elif kinds[n] == RIGID_BODY and quantities[n].startswith("Rotation"):
            columns[n] = f"hand {name} q{axis}"
    return [SourceRecording(path, frame[list(columns)].rename(columns=columns))]
