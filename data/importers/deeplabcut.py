"""Point tables of DeepLabCut (https://deeplabcut.github.io).

They are CSV with three or four lines of headings.
"""

from __future__ import annotations

from pathlib import Path

from stringcast.data.file_checks import begins_with, check_csv, read_frame
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

# first cells of the heading lines
HEADINGS = ("scorer", "individuals", "bodyparts", "coords")


def recognises(path: Path) -> bool:
    """Return whether a file begins like CSV of DeepLabCut."""
    return path.suffix.lower() == ".csv" and begins_with(path, "scorer,", "utf-8")


def read(path: Path) -> list[SourceRecording]:
    """Read the positions of all points [px] by frame, as one recording.

    Raises DataError if the file is damaged.
    """
    headings = {}
    count = 0
    with check_csv(path).open(encoding="utf-8", errors="replace") as file:
        for _ in HEADINGS:
            cells = file.readline().rstrip("\n").split(",")
            if cells[0] in HEADINGS:
                headings[cells[0]] = cells
                count += 1
    frame = read_frame(
        path, "DeepLabCut's CSV", "Export it again.", header=None, skiprows=count
    )
    width = frame.shape[1]
    parts = headings.get("bodyparts")
    coordinates = headings.get("coords", [])
    if parts is None or len(coordinates) != width:
        raise DataError(
            path,
            "its lines 'bodyparts' and 'coords' do not fit its columns",
            "Export it again.",
        )
    animals = headings.get("individuals", [""] * width)
    names = ["frame"]
    for animal, part, coordinate in zip(
        animals[1:], parts[1:], coordinates[1:], strict=True
    ):
        names.append(column_name(" ".join(filter(None, (animal, part))), coordinate))
    return [SourceRecording(path, frame.set_axis(names, axis=1))]


def column_name(part: str, coordinate: str) -> str:
    """Name a column, such as `tip x [px]` or `tip likelihood`."""
    unit = " [px]" if coordinate in ("x", "y") else ""
    return f"{part} {coordinate}{unit}"
