"""How the content of stored files differs, to the bit: what `verify` and `diff` say of
tables and pictures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data import store
from stringcast.data.lazy_module import LazyModule

cv2 = LazyModule("cv2")
MAX_VALUE_CHARACTERS = 60  # characters of a value that are shown


def folder_differences(
    a: Path, b: Path, leave_out: frozenset[str] = frozenset()
) -> list[str]:
    """Differences of two folders, a line each; hidden files and the names in
    `leave_out` do not count.
    """
    inside = {
        path.relative_to(home)
        for home in (a, b)
        for path in home.rglob("*")
        if path.is_file()
    }
    names = [
        p
        for p in inside
        if p.name not in leave_out and not any(part.startswith(".") for part in p.parts)
    ]
    return [
        f"{name.as_posix()}: {words}"
        for name in sorted(names)
        for words in file_differences(a / name, b / name)
    ]


def file_differences(a: Path, b: Path) -> list[str]:
    """Differences in the content of two files, a line each; none if they are the same.
    The origin in a footer does not count.
    """
    for path, which in ((a, "the second"), (b, "the first")):
        if not path.is_file():
            return [f"it is only in {which}"]
    if a.suffix == ".parquet":
        return _table_differences(a, b)
    if a.read_bytes() == b.read_bytes():
        return []
    if a.suffix != ".png":
        return ["it has another content"]
    one, other = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (a, b))
    if one is None or other is None or one.shape != other.shape:
        return ["the image has another size or cannot be read"]
    # the same picture may be packed otherwise
    apart = np.abs(one.astype(int) - other.astype(int))
    return (
        [
            f"{np.count_nonzero(apart)} pixels differ, at most by {apart.max()} grey levels"
        ]
        if apart.any()
        else []
    )


def _table_differences(a: Path, b: Path) -> list[str]:
    """Columns, their order and types, rows, and every value to the bit."""
    try:
        if store.content_hash(a) == store.content_hash(b):
            return []
        one, other = (
            pq.read_table(path, partitioning=None, page_checksum_verification=True)
            for path in (a, b)
        )
    except store.READ_ERRORS as error:
        return [f"it is not a whole Parquet file ({error})"]
    if one.column_names != other.column_names:
        return [
            f"columns are {', '.join(one.column_names)} and {', '.join(other.column_names)}"
        ]
    both = [(name, one[name], other[name]) for name in one.column_names]
    types = [
        f"column {name} is {x.type} and {y.type}"
        for name, x, y in both
        if x.type != y.type
    ]
    if types or one.num_rows != other.num_rows:
        return types or [f"it has {one.num_rows} and {other.num_rows} rows"]
    return [
        f"column {name}: {words}"
        for name, x, y in both
        if (words := _column_difference(x, y))
    ]


def _column_difference(a: pa.ChunkedArray, b: pa.ChunkedArray) -> str:
    """Where two columns of one type first differ, and numbers how much at most; empty
    if nowhere. Of floating point the bits count, so that 0 is not -0, and NaN is NaN.
    """
    if not (floating := pa.types.is_floating(a.type)):
        x, y = a.to_pylist(), b.to_pylist()
        rows = [
            row
            for row, (one, other) in enumerate(zip(x, y, strict=True))
            if one != other
        ]
    else:
        x, y = a.to_numpy(), b.to_numpy()
        rows = np.flatnonzero(
            x.view(f"u{x.itemsize}") != y.view(f"u{y.itemsize}")
        ).tolist()
    if not rows:
        return ""
    words = f"{len(rows)} of {len(x)} rows differ, first row {rows[0]}: {_abbreviate(x[rows[0]])} and {_abbreviate(y[rows[0]])}"
    with np.errstate(invalid="ignore"):
        apart = np.abs(x[rows] - y[rows]) if floating else np.array([np.nan])
    at = (
        ""
        if np.isnan(apart).all()
        else f", at most {np.nanmax(apart):.3g} apart (row {rows[np.nanargmax(apart)]})"
    )
    return words + at


def _abbreviate(value: object) -> str:
    said = repr(float(value)) if isinstance(value, np.floating) else repr(value)
    return (
        said
        if len(said) <= MAX_VALUE_CHARACTERS
        else said[: MAX_VALUE_CHARACTERS - 3] + "..."
    )
