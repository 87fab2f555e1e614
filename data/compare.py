"""Differences in the content of stored files, compared to the bit.

`verify` and `diff` report them for tables and pictures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data import store
from stringcast.data.file_checks import (
    MAX_TABLE_BYTES,
    check_parquet,
    require_plain_file,
)
from stringcast.data.images import image_size
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError

cv2 = LazyModule("cv2")
MAX_VALUE_CHARACTERS = 60  # characters shown of a value


def folder_differences(a: Path, b: Path, leave_out: frozenset[str]) -> list[str]:
    """Describe the differences of two folders, one line each.

    Hidden files and files whose name is in `leave_out` are ignored.
    """
    names = set()
    for folder in (a, b):
        for path in folder.rglob("*"):
            name = path.relative_to(folder)
            is_hidden = any(part.startswith(".") for part in name.parts)
            if path.is_file() and path.name not in leave_out and not is_hidden:
                names.add(name)
    lines = []
    for name in sorted(names):
        differences = file_differences(a / name, b / name)
        lines += [f"{name.as_posix()}: {words}" for words in differences]
    return lines


def file_differences(a: Path, b: Path) -> list[str]:
    """Describe the differences in content of two files, one line each.

    The origin in the footer of a table is ignored.
    """
    for path, other in ((a, "second"), (b, "first")):
        if not path.is_file():
            return [f"it is only in the {other}"]
    try:
        for path in (a, b):
            require_readable(path)
    except (DataError, *store.READ_ERRORS) as error:
        return [str(error)]
    if a.suffix == ".parquet":
        return _table_differences(a, b)
    if a.read_bytes() == b.read_bytes():
        return []
    if a.suffix == ".png":
        return _image_differences(a, b)
    return ["it has another content"]


def require_readable(path: Path) -> None:
    """Raise DataError for a file that would not fit into memory."""
    require_plain_file(path, MAX_TABLE_BYTES)
    if path.suffix == ".parquet":
        check_parquet(path, ())
    if path.suffix == ".png":
        image_size(path)


def _image_differences(a: Path, b: Path) -> list[str]:
    first = cv2.imread(str(a), cv2.IMREAD_UNCHANGED)
    second = cv2.imread(str(b), cv2.IMREAD_UNCHANGED)
    if first is None or second is None or first.shape != second.shape:
        return ["the image has another size or cannot be read"]
    distance = np.abs(first.astype(int) - second.astype(int))
    if not distance.any():  # equal pictures may be compressed differently
        return []
    count = np.count_nonzero(distance)
    return [f"{count} pixels differ, at most by {distance.max()} grey levels"]


def _read_checked(path: Path) -> pa.Table:
    """Read a Parquet file and the checksums of its pages."""
    return pq.read_table(path, partitioning=None, page_checksum_verification=True)


def _table_differences(a: Path, b: Path) -> list[str]:
    """Compare order and types of columns, number of rows, and the bits of values."""
    try:
        if store.content_hash(a) == store.content_hash(b):
            return []
        first, second = _read_checked(a), _read_checked(b)
    except store.READ_ERRORS as error:
        return [f"it is not a whole Parquet file ({error})"]
    names = first.column_names
    if names != second.column_names:
        return [f"columns are {', '.join(names)} and {', '.join(second.column_names)}"]
    lines = []
    for name in names:
        kinds = first[name].type, second[name].type
        if kinds[0] != kinds[1]:
            lines.append(f"column {name} is {kinds[0]} and {kinds[1]}")
    if lines:
        return lines
    if first.num_rows != second.num_rows:
        return [f"it has {first.num_rows} and {second.num_rows} rows"]
    for name in names:
        words = _column_difference(first[name], second[name])
        if words:
            lines.append(f"column {name}: {words}")
    return lines


def _column_difference(a: pa.ChunkedArray, b: pa.ChunkedArray) -> str:
    """Describe where two columns first differ, and the largest difference.

    Floating-point numbers are compared by their bits: 0 differs from -0, and NaN equals
    NaN. The result is empty for equal columns.
    """
    if pa.types.is_floating(a.type):
        x, y = a.to_numpy(), b.to_numpy()
        bits = f"u{x.itemsize}"
        rows = np.flatnonzero(x.view(bits) != y.view(bits)).tolist()
        with np.errstate(invalid="ignore"):
            distances = np.abs(x[rows] - y[rows])
    else:
        x, y = a.to_pylist(), b.to_pylist()
        rows = [row for row in range(len(x)) if x[row] != y[row]]
        distances = np.array([])
    if not rows:
        return ""
    row = rows[0]
    words = f"{len(rows)} of {len(x)} rows differ, "
    words += f"first row {row}: {_abbreviate(x[row])} and {_abbreviate(y[row])}"
    if not np.isnan(distances).all():
        farthest = rows[np.nanargmax(distances)]
        words += f", at most {np.nanmax(distances):.3g} apart (row {farthest})"
    return words


def _abbreviate(value: object) -> str:
    if isinstance(value, np.floating):
        value = float(value)
    text = repr(value)
    if len(text) > MAX_VALUE_CHARACTERS:
        text = text[: MAX_VALUE_CHARACTERS - 3] + "..."
    return text
