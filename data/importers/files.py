"""Which reader reads which file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stringcast.data.images import VIDEOS
from stringcast.data.importers import Recording, deeplabcut, deeplabcut_h5, lerobot, mcap, optitrack, tables
from stringcast.data.schema import DataError

READERS = (lerobot, deeplabcut, deeplabcut_h5, optitrack, mcap, tables)  # the first that knows a file reads it


def recordings(paths: Sequence[Path]) -> list[Recording]:
    """All that these files hold. Raises DataError naming the file and the remedy."""
    return [recording for path in paths for recording in _read(path)]


def _read(path: Path) -> list[Recording]:
    if not path.exists():
        raise DataError(f"{path}: there is no such file. Look at its name.")
    if path.suffix.lower() in VIDEOS:
        return [Recording(path, tables.NOTHING, film=path)]
    for reader in READERS:
        if reader.reads(path):
            return reader.read(path)
    if path.is_dir():
        raise DataError(f"{path}: this is a folder, and no dataset of LeRobot. Name its files: {path}/*.csv")
    known = ", ".join((*tables.ENDINGS, ".h5", ".mcap", *VIDEOS))
    raise DataError(f"{path}: no such file is read. Export it as one of {known}.")
