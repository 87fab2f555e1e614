"""Writes and reads artifacts, so that nothing half-written is ever read as whole.

An artifact is a folder with one Parquet file for each of its tables, and the frames of
a trial under the names in its table `frames`. It is written beside its place, every
file closed, read back and synced, and only then given its name, which appears whole or
not at all. What made a file (its origin) is in the Parquet footer.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data import disk, file_checks
from stringcast.data.errors import remedy_for
from stringcast.data.images import ImageFiles, encode_png
from stringcast.data.schema import DataError, Table

Artifact = TypeVar("Artifact")
CHUNK_BYTES = 2**20  # [bytes] of a file that are hashed at a time
READ_ERRORS = (pa.ArrowException, OSError, ValueError)


def save(artifact: Any, folder: Path, origin: Mapping[str, Any]) -> None:
    """Write an artifact as `folder`, replacing one that is there.

    origin: what made it, JSON-able; goes into every footer. Raises DataError where it
    cannot be written; what was there before is then still there. Only a kill between
    the two renames of a replacement leaves neither.
    """
    with write_atomically(folder) as aside:
        disk.make_folder(aside)
        tables = artifact.tables() if hasattr(artifact, "tables") else artifact.TABLES
        for name, table in tables.items():
            _write_parquet(
                table, getattr(artifact, name), aside / f"{name}.parquet", origin
            )
        if hasattr(artifact, "images"):
            files = [aside / file for file in artifact.frames["file"]]
            for file, image in zip(files, artifact.images, strict=True):
                disk.make_folder(file.parent)
                disk.write(file, encode_png(image))
            for inside in {file.parent for file in files}:
                disk.sync_folder(inside)
        disk.sync_folder(aside)


def load(kind: type[Artifact], folder: Path) -> Artifact:
    """Read an artifact of `kind`; raises DataError naming the file and the remedy.
    Images are read when asked for.
    """
    if not folder.is_dir():
        raise DataError(
            f"{folder}: there is no {kind.__name__.lower()} here. Name a run folder that holds one."
        )
    tables: dict[str, Any] = {}
    for name, table in kind.TABLES.items():  # type: ignore[attr-defined]
        tables[name] = read_table(table, folder / f"{name}.parquet")
    if "images" in kind.__dataclass_fields__:  # type: ignore[attr-defined]
        tables["images"] = load_images(folder, tables["frames"])
    return kind(**tables)


def load_images(folder: Path, frames: pd.DataFrame) -> ImageFiles:
    """The images of a table `frames`, whose paths are relative to `folder`; raises
    DataError where one is missing.
    """
    lost = [file for file in frames["file"] if not (folder / file).is_file()]
    if lost:
        raise DataError(
            f"{folder / lost[0]}: the frame is missing{f' ({len(lost)} are)' if len(lost) > 1 else ''}. "
            "Restore it, or leave the trial out."
        )
    return ImageFiles(folder, tuple(frames["file"]))


def write_table(
    table: Table, frame: pd.DataFrame, path: Path, origin: Mapping[str, Any]
) -> None:
    """Write one table as `path`, whole or not at all."""
    with write_atomically(path) as aside:
        _write_parquet(table, frame, aside, origin)


def read_table(table: Table, path: Path) -> pd.DataFrame:
    """Read and check one table; raises DataError naming the file, the column and the
    remedy.
    """
    try:
        if not path.exists():
            raise FileNotFoundError(path)
        columns, texts = file_checks.check_parquet(
            path, [column.name for column in table.columns]
        )
        with pq.ParquetFile(
            path, page_checksum_verification=True, read_dictionary=texts
        ) as file:
            name = (
                (file.schema_arrow.metadata or {})
                .get(b"table", table.name.encode())
                .decode()
            )
            frame = file.read(columns).to_pandas()
        frame = frame.astype({text: object for text in texts if text in frame})
    except FileNotFoundError as error:
        raise DataError(
            f"{path}: the file is missing. Restore it, or run the step that makes it again."
        ) from error
    except READ_ERRORS as error:
        raise DataError(
            f"{path}: not a whole Parquet file ({error}). Restore it or delete it and run again."
        ) from error
    if name != table.name:
        raise DataError(
            f"{path}: holds the table '{name}', not '{table.name}'. Put the right file there."
        )
    return table.check(frame, str(path))


def read_origin(path: Path) -> dict[str, Any]:
    """The provenance in the footer of a Parquet file, or of the first one in a folder;
    empty for a file that is not ours. Raises DataError for a folder that holds none.
    """
    if path.is_dir():
        folder, path = path, min(path.glob("*.parquet"), default=path)
        if path == folder:
            raise DataError(f"{folder}: there is no table in it. Delete the folder.")
    if path.exists():
        file_checks.require_plain_file(path)
    metadata = pq.read_schema(path).metadata or {}
    return json.loads(metadata.get(b"origin", b"{}"))


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with write_atomically(path) as aside:
        disk.write(aside, text.encode())


def content_hash(path: Path) -> str:
    """SHA-256 of a file's content, or of a folder's files and their names.

    Of a Parquet file its columns count, with their types and units, not the origin in
    its footer: the same numbers have the same hash, whichever run they come from.
    """
    digest = hashlib.sha256()
    files = (
        [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    )
    for file in files:
        with file.open("rb") as content:
            head, size = b"", file.stat().st_size
            if file.suffix == ".parquet":
                # it ends with the footer, the footer's length (4 bytes) and "PAR1"; all
                # before is the columns' pages
                head = pq.read_schema(file).remove_metadata().serialize().to_pybytes()
                end = content.seek(-8, os.SEEK_END)
                size = end - int.from_bytes(content.read(4), "little")
                content.seek(0)
            digest.update(
                f"{file.relative_to(path).as_posix()}\0{len(head) + size}\0".encode()
                + head
            )
            # a film may be larger than the memory
            while size > 0 and (piece := content.read(min(CHUNK_BYTES, size))):
                size -= len(piece)
                digest.update(piece)
    return digest.hexdigest()


def _write_parquet(
    table: Table, frame: pd.DataFrame, path: Path, origin: Mapping[str, Any]
) -> None:
    """Write and read back; the caller gives the file its name. The same content gives
    the same bytes.
    """
    checked = table.check(frame, path.name)
    schema = table.arrow_schema(checked)
    metadata = {
        **(schema.metadata or {}),
        b"origin": json.dumps(origin, sort_keys=True).encode(),
    }
    content = pa.Table.from_pandas(
        checked, schema=schema, preserve_index=False
    ).replace_schema_metadata(metadata)
    buffer = pa.BufferOutputStream()
    pq.write_table(content, buffer, write_page_checksum=True)
    disk.write(path, buffer.getvalue().to_pybytes())
    if pq.read_metadata(path).num_rows != len(checked):
        raise OSError(errno.EIO, "it reads back differently")


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """A name beside `path` to write to; on success it becomes `path`, else it goes, and
    what was there stays.
    """
    aside = _sibling_name(path)
    try:
        disk.make_folder(path.parent)
        yield aside
        _move_into_place(aside, path)
        disk.sync_folder(path.parent)
    except (OSError, pa.ArrowException) as error:
        why = getattr(error, "strerror", None) or error
        remedy = remedy_for(error)
        raise DataError(
            f"{path}: cannot be written ({why}). {remedy}; nothing half-written is left."
        ) from error
    finally:
        _remove_leftovers(path)


def _sibling_name(path: Path, role: str = "part") -> Path:
    """A new name in the same folder, and so on the same disk."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.{role}")


def _remove_leftovers(path: Path) -> None:
    """Remove what was left beside `path`, by us or by one that was killed; never the
    only whole copy.
    """
    ours = re.compile(re.escape(f".{path.name}.") + r"[0-9a-f]{8}\.(part|replaced)")
    with suppress(OSError):
        for left in path.parent.iterdir():
            match = ours.fullmatch(left.name)
            if match and (match[1] == "part" or path.exists()):
                disk.remove(left)


def _move_into_place(aside: Path, path: Path) -> None:
    """Give `aside` its name. A folder of that name steps aside first, for no system
    replaces a full one.
    """
    if not path.is_dir():
        disk.rename(aside, path)
        return
    old = _sibling_name(path, "replaced")
    disk.rename(path, old)
    try:
        disk.rename(aside, path)
    except BaseException:
        disk.rename(old, path)
        raise
