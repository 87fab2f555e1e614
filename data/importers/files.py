"""The choice of a reader for each file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

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

# the first reader that recognises a file reads it
READERS = (lerobot, deeplabcut, deeplabcut_h5, optitrack, mcap, tables)


def read_recordings(paths: Sequence[Path]) -> list[SourceRecording]:
    """Read all recordings of these files, in the order of the files.

    They are files of any format in `READERS`, videos, or folders of LeRobot datasets.
    Raises DataError if one is missing, damaged or of an unknown format; it names the
    file and the remedy.
    """
    results = []
    for path in paths:
        if not path.exists():
            raise DataError(path, "there is no such file", "Look at its name.")
        if path.suffix.lower() in VIDEO_SUFFIXES:
            results.append(SourceRecording(path, pd.DataFrame(), film=path))
            continue
        for reader in READERS:
            if reader.recognises(path):
                results += reader.read(path)
                break
        else:
            _refuse_format(path)
    return results


def _refuse_format(path: Path) -> None:
    if path.is_dir():
        raise DataError(
            path,
            "this is a folder, and no dataset of LeRobot",
            f"Name its files: {path}/*.csv",
        )
    formats = ", ".join((*tables.TABLE_SUFFIXES, ".h5", ".mcap", *VIDEO_SUFFIXES))
    raise DataError(
        path,
        "no such file is read",
        f"Export it as one of {formats}.",
    )
