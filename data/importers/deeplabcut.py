"""DeepLabCut's tables of points (https://deeplabcut.github.io): CSV with three or four
lines of headings.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from stringcast.data.file_checks import check_csv
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

# the first cell of each of those lines
HEADINGS = ("scorer", "individuals", "bodyparts", "coords")
MAX_HEADING_LINES = 4  # lines of headings


def reads(path: Path) -> bool:
    """Whether a file begins as DeepLabCut's CSV does."""
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(len(HEADINGS[0]) + 1) == "scorer,"


def read(path: Path) -> list[SourceRecording]:
    """Places of its points [px] by frame, one recording; raises DataError where it is
    damaged.
    """
    with check_csv(path).open(encoding="utf-8", errors="replace") as file:
        begins = [
            file.readline().rstrip("\n").split(",") for _ in range(MAX_HEADING_LINES)
        ]
    lines = [line for line in begins if line[0] in HEADINGS]
    try:
        frame = pd.read_csv(path, header=None, skiprows=len(lines))
    except (ValueError, OSError) as error:
        raise DataError(
            f"{path}: cannot be read as DeepLabCut's CSV ({error}). Export it again."
        ) from error
    named = {line[0]: line for line in lines}
    if (
        not {"bodyparts", "coords"} <= {*named}
        or len(named["coords"]) != frame.shape[1]
    ):
        raise DataError(
            f"{path}: its lines 'bodyparts' and 'coords' do not fit its columns. Export it again."
        )
    animals = named.get("individuals", [""] * frame.shape[1])
    parts = [
        " ".join(filter(None, both))
        for both in zip(animals, named["bodyparts"], strict=True)
    ]
    names = [
        "frame",
        *(
            column_name(*both)
            for both in zip(parts[1:], named["coords"][1:], strict=True)
        ),
    ]
    return [SourceRecording(path, frame.set_axis(names, axis=1))]


def column_name(part: str, coordinate: str) -> str:
    """A name that says what the column is: `tip x [px]`, `tip likelihood`."""
    return (
        f"{part} {coordinate} [px]"
        if coordinate in ("x", "y")
        else f"{part} {coordinate}"
    )
