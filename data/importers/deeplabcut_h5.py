"""DeepLabCut's tables in HDF5, as pandas stores them (`df_with_missing/table`); needs
h5py.

pandas would read them by PyTables, which unpickles whatever attributes hold. Here the
names of columns alone are unpickled, by a reader that knows lists, tuples and texts and
calls nothing.
"""

from __future__ import annotations

import io
import pickle
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import pandas as pd

from stringcast.data.file_checks import MAX_COLUMNS, MAX_TABLE_BYTES, require_plain_file
from stringcast.data.importers import SourceRecording
from stringcast.data.importers.deeplabcut import column_name
from stringcast.data.schema import DataError

TABLE_PATH = "df_with_missing/table"
VALUES_COLUMN = "values_block_0"
# [bytes] of the attribute that holds the names: HDF5 stores no longer ones beside a
# table
MAX_NAMES_BYTES = 2**16


class _TextUnpickler(pickle.Unpickler):
    """Unpickles numbers, texts, lists and tuples; whatever would call something is
    refused.
    """

    def find_class(self, module: str, name: str) -> NoReturn:
        """Refuse to look a class up: nothing in the file is to be run."""
        raise pickle.UnpicklingError(f"it names {module}.{name}")


def reads(path: Path) -> bool:
    """Whether a file's name ends as HDF5's do."""
    return path.suffix.lower() in (".h5", ".hdf5")


def read(path: Path) -> list[SourceRecording]:
    """Places of its points [px] by frame, one recording; raises DataError where it is
    damaged or h5py is not there.
    """
    if find_spec("h5py") is None:
        raise DataError(
            f"{path}: to read HDF5 (or import the CSV beside it), h5py is needed: pip install h5py"
        )
    import h5py  # noqa: PLC0415

    try:
        with h5py.File(require_plain_file(path), "r") as file:
            table = file[TABLE_PATH]
            if table.dtype.itemsize * len(table) > MAX_TABLE_BYTES:
                raise DataError(
                    f"{path}: it has {len(table)} rows, more than are read. Split it."
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
            f"{path}: not a table of DeepLabCut ({error}). Import the CSV beside it, or export it again."
        ) from error


def _unpickle_names(pickled: bytes) -> list[str]:
    """The column names, from the pickled names of scorer, point and coordinate. Raises
    ValueError where they are none.
    """
    whole: Any = _TextUnpickler(io.BytesIO(pickled[:MAX_NAMES_BYTES])).load()
    if not isinstance(whole, list) or len(whole) > MAX_COLUMNS:
        raise ValueError("its columns have no names")
    for levels in whole:
        if (
            not isinstance(levels, tuple)
            or len(levels) < 3
            or not all(isinstance(level, str) for level in levels)
        ):
            raise ValueError("its columns have no names of three parts")
    return [column_name(" ".join(levels[1:-1]), levels[-1]) for levels in whole]
