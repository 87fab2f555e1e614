"""Which reader reads which file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stringcast.data.images import VIDEO_SUFFIXES
from stringcast.data.importers import (
    SourceRecording,
    deeplabcut,
    deeplabcut_h5,
    lerobot,
    mcap,
    optitrack,
    tables,
)
from stringcast.data.schema import DataError

# the first that knows a file reads it
READERS = (lerobot, deeplabcut, deeplabcut_h5, optitrack, mcap, tables)


def read_recordings(paths: Sequence[Path]) -> list[SourceRecording]:
    """All that these files hold. Raises DataError naming the file and the remedy."""
    found: list[SourceRecording] = []
    for path in paths:
        if not path.exists():
            raise DataError(f"{path}: there is no such file. Look at its name.")
        reader = next((one for one in READERS if one.reads(path)), None)
        if path.suffix.lower() in VIDEO_SUFFIXES:
            found.append(SourceRecording(path, tables.EMPTY_TABLE, film=path))
        elif reader is not None:
            found += reader.read(path)
        elif path.is_dir():
            raise DataError(
                f"{path}: this is a folder, and no dataset of LeRobot. Name its files: {path}/*.csv"
            )
        else:
            known = ", ".join((*tables.TABLE_SUFFIXES, ".h5", ".mcap", *VIDEO_SUFFIXES))
            raise DataError(
                f"{path}: no such file is read. Export it as one of {known}."
            )
    return found
