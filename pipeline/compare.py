"""Compare stored tables, images and files by their content, and say in words where they first differ."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data.store import UNREADABLE, content_hash


def differing_files(a: Path, b: Path, leave_out: frozenset[str] = frozenset()) -> dict[str, list[str]]:
    """What differs between two folders, in words, by file; hidden files and the names in `leave_out` do not count."""
    names = sorted(_files(a, leave_out) | _files(b, leave_out))
    found = {name: differences(a / name, b / name) for name in names}
    return {name: words for name, words in found.items() if words}


def _files(folder: Path, leave_out: frozenset[str]) -> set[str]:
    inside = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {p.as_posix() for p in inside if p.name not in leave_out and not any(x.startswith(".") for x in p.parts)}


def differences(a: Path, b: Path) -> list[str]:
    """How the content of two files differs, in words; none if it is the same. The origin in a footer does not count."""
    for path, which in ((a, "the second"), (b, "the first")):
        if not path.is_file():
            return [f"it is only in {which}"]
    if a.suffix == ".parquet":
        return _of_tables(a, b)
    if a.read_bytes() == b.read_bytes():
        return []
    return _of_images(a, b) if a.suffix == ".png" else ["it has another content"]


def _of_tables(a: Path, b: Path) -> list[str]:
    """Columns, their order and types, rows, and every value to the bit."""
    try:
        if content_hash(a) == content_hash(b):
            return []
        one, other = (pq.read_table(path, partitioning=None, page_checksum_verification=True) for path in (a, b))
    except UNREADABLE as error:
        return [f"it is not a whole Parquet file ({error})"]
    if one.column_names != other.column_names:
        return [f"columns are {', '.join(one.column_names)} and {', '.join(other.column_names)}"]
    pairs = [(name, one[name], other[name]) for name in one.column_names]
    types = [f"column {name} is {x.type} and {y.type}" for name, x, y in pairs if x.type != y.type]
    if types or one.num_rows != other.num_rows:
        return types or [f"it has {one.num_rows} and {other.num_rows} rows"]
    return [words for name, x, y in pairs if (words := _of_columns(name, x, y))]


def _of_columns(name: str, a: pa.ChunkedArray, b: pa.ChunkedArray) -> str:
    """Where two columns of one type first differ, and how much at most; empty if nowhere."""
    if pa.types.is_floating(a.type):
        return _of_numbers(name, a.to_numpy(), b.to_numpy())
    x, y = a.to_pylist(), b.to_pylist()
    rows = [row for row, (one, other) in enumerate(zip(x, y, strict=True)) if one != other]
    return f"column {name}: {_first(rows, len(x), x, y)}" if rows else ""


def _of_numbers(name: str, a: np.ndarray, b: np.ndarray) -> str:
    """The same for floating point: bits count, so that 0 is not -0, and NaN is NaN."""
    rows = np.flatnonzero(a.view(f"u{a.itemsize}") != b.view(f"u{b.itemsize}"))
    if not len(rows):
        return ""
    with np.errstate(invalid="ignore"):
        apart = np.abs(a[rows] - b[rows])
    largest = (
        "" if np.isnan(apart).all() else f", at most {np.nanmax(apart):.3g} apart (row {rows[np.nanargmax(apart)]})"
    )
    return f"column {name}: {_first(rows.tolist(), len(a), a, b)}{largest}"


def _first(rows: list[int], count: int, a: object, b: object) -> str:
    first = rows[0]
    one, other = a[first], b[first]  # type: ignore[index]
    return f"{len(rows)} of {count} rows differ, first row {first}: {_short(one)} and {_short(other)}"


def _short(value: object) -> str:
    said = repr(float(value)) if isinstance(value, np.floating) else repr(value)
    return said if len(said) <= 60 else said[:57] + "..."


def _of_images(a: Path, b: Path) -> list[str]:
    """How two pictures differ; the same picture may be packed otherwise."""
    one, other = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (a, b))
    if one is None or other is None or one.shape != other.shape:
        return ["the image has another size or cannot be read"]
    apart = np.abs(one.astype(int) - other.astype(int))
    return [f"{np.count_nonzero(apart)} pixels differ, at most by {apart.max()} grey levels"] if apart.any() else []
