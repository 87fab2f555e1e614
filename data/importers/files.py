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
    found: list[Recording] = []
    for path in paths:
        if not path.exists():
            raise DataError(f"{path}: there is no such file. Look at its name.")
        reader = next((one for one in READERS if one.reads(path)), None)
        if path.suffix.lower() in VIDEOS:
            found.append(Recording(path, tables.NOTHING, film=path))
        elif reader is not None:
            found += reader.read(path)
        elif path.is_dir():
            raise DataError(f"{path}: this is a folder, and no dataset of LeRobot. Name its files: {path}/*.csv")
        else:
            known = ", ".join((*tables.ENDINGS, ".h5", ".mcap", *VIDEOS))
            raise DataError(f"{path}: no such file is read. Export it as one of {known}.")
    return found
