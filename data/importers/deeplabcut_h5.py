"""Tables of DeepLabCut in HDF5, as pandas stores them (`df_with_missing/table`).

pandas would use PyTables, which unpickles any attribute and may run code. Here a
restricted reader of lists, tuples and texts unpickles the column names.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any, NoReturn

import pandas as pd

from stringcast.data.file_checks import MAX_COLUMNS, MAX_TABLE_BYTES, require_plain_file
from stringcast.data.importers import SourceRecording
from stringcast.data.importers.deeplabcut import column_name
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError

h5py = LazyModule("h5py")

TABLE_PATH = "df_with_missing/table"
VALUES_COLUMN = "values_block_0"
# [bytes] of the attribute with the names: the limit of HDF5
MAX_NAMES_BYTES = 2**16


class _TextUnpickler(pickle.Unpickler):
    """Unpickler of numbers, texts, lists and tuples that refuses all calls."""

    def find_class(self, module: str, name: str) -> NoReturn:
        """Refuse all classes, so that no code of the file runs."""
        raise pickle.UnpicklingError(f"it names {module}.{name}")


def recognises(path: Path) -> bool:
    """Return whether a file has the suffix of HDF5."""
    return path.suffix.lower() in (".h5", ".hdf5")


def read(path: Path) -> list[SourceRecording]:
    """Read the positions of all points [px] by frame, as one recording.

    Raises DataError if the file is damaged.
    """
    try:
        with h5py.File(require_plain_file(path), "r") as file:
            table = file[TABLE_PATH]
            if table.dtype.itemsize * len(table) > MAX_TABLE_BYTES:
                raise DataError(
                    path,
                    f"it has {len(table)} rows, more than are read",
                    "Split it.",
                )
            names = _unpickle_names(bytes(table.attrs[f"{VALUES_COLUMN}_kind"]))
            frame = pd.DataFrame(table[VALUES_COLUMN], columns=names)
            return [SourceRecording(path, frame.assign(frame=table["index"]))]
    except (
        OSError,
        KeyError,
        ValueError,
        pickle.UnpicklingError,
        EOFError,
        IndexError,
    ) as error:
        raise DataError(
            path,
            f"not a table of DeepLabCut ({error})",
            "Import the CSV beside it, or export it again.",
        ) from error


def _unpickle_names(pickled: bytes) -> list[str]:
    """Name the columns from pickled tuples of scorer, point and coordinate.

    Raises ValueError for anything else.
    """
    columns: Any = _TextUnpickler(io.BytesIO(pickled[:MAX_NAMES_BYTES])).load()
    if not isinstance(columns, list) or len(columns) > MAX_COLUMNS:
        raise ValueError("its columns have no names")
    names = []
    for levels in columns:
        is_named = isinstance(levels, tuple) and len(levels) >= 3
        if not is_named or not all(isinstance(level, str) for level in levels):
            raise ValueError("its columns have no names of three parts")
        names.append(column_name(" ".join(levels[1:-1]), levels[-1]))
    return names
