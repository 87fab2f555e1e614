"""The store of artifacts, written atomically.

An artifact is a folder with one Parquet file for each of its tables, and the frames of
a trial under the names in its table `frames`. It is written under a temporary name in
the same folder; when all files are closed, checked and synced, it is renamed. So it
appears whole or not at all. The Parquet footer holds the origin of a file.
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
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, Field

from stringcast.data import disk, file_checks
from stringcast.data.errors import remedy_for
from stringcast.data.images import ImageFiles, encode_png
from stringcast.data.schema import UNSET, DataError, Table

Artifact = TypeVar("Artifact")
DIGEST_COLUMN = "sha256"  # column of the table `frames`
MAX_INPUTS = 10_000  # per step: up to three for each trial
CHUNK_BYTES = 2**20  # [bytes] hashed at a time
READ_ERRORS = file_checks.READ_ERRORS


class Making(BaseModel):
    """When a step was made, and how long it took [s]."""

    at: str
    seconds: float


class Origin(BaseModel):
    """The parts of an origin that commands read; each may be missing."""

    step: str = ""
    python: str = ""
    inputs: Annotated[dict[str, str], Field(max_length=MAX_INPUTS)] = {}
    config: dict[str, Any] = {}
    code: dict[str, str] = {}
    packages: dict[str, str] = {}
    made: Making = UNSET


def save(artifact: Any, folder: Path, origin: Mapping[str, Any]) -> None:
    """Write an artifact, such as a `Trial`, as a folder, replacing an existing one.

    `origin` holds JSON values for the footer of every table. Raises DataError if the
    folder cannot be written; a former folder stays. Only a kill between the two renames
    of a replacement leaves neither.
    """
    with write_atomically(folder) as part:
        disk.make_folder(part)
        if hasattr(artifact, "images"):
            artifact = _save_images(artifact, part)
        tables = artifact.tables() if hasattr(artifact, "tables") else artifact.TABLES
        for name, table in tables.items():
            frame = getattr(artifact, name)
            _write_parquet(table, frame, part / f"{name}.parquet", origin)
        disk.sync_folder(part)


def _save_images(artifact: Any, folder: Path) -> Any:
    """Write the images of a trial and return it with their digests."""
    digests = []
    files = [folder / file for file in artifact.frames["file"]]
    for file, image in zip(files, artifact.images, strict=True):
        content = encode_png(image)
        disk.make_folder(file.parent)
        disk.write(file, content)
        digests.append(hashlib.sha256(content).hexdigest())
    for parent in {file.parent for file in files}:
        disk.sync_folder(parent)
    return replace(artifact, frames=artifact.frames.assign(sha256=digests))


def load(kind: type[Artifact], folder: Path) -> Artifact:
    """Read an artifact from its folder; images are read on first use.

    Raises DataError if a file is missing or damaged; it names the file and the remedy.
    """
    if not folder.is_dir():
        raise DataError(
            folder,
            f"there is no {kind.__name__.lower()} here",
            "Name a run folder that holds one.",
        )
    tables: dict[str, Table] = kind.TABLES  # type: ignore[attr-defined]
    content: dict[str, Any] = {
        name: read_table(table, folder / f"{name}.parquet")
        for name, table in tables.items()
    }
    if "images" in kind.__dataclass_fields__:  # type: ignore[attr-defined]
        content["images"] = load_images(folder, content["frames"])
    return kind(**content)


def load_images(folder: Path, frames: pd.DataFrame) -> ImageFiles:
    """Open the images of a table `frames`, whose paths are relative to `folder`.

    Raises DataError if one is missing, unless no image of the trial was kept.
    """
    files = tuple(frames["file"])
    for file in files:
        if file_checks.is_outside(folder, str(file)):
            raise DataError(
                folder,
                f"the frame {str(file)!r} lies outside this folder",
                "Put the frames there.",
            )
    missing = [file for file in files if not (folder / file).is_file()]
    if missing and not (DIGEST_COLUMN in frames and len(missing) == len(files)):
        count = f" ({len(missing)} are)" if len(missing) > 1 else ""
        raise DataError(
            folder / missing[0],
            f"the frame is missing{count}",
            "Restore it, or leave the trial out.",
        )
    return ImageFiles(folder, files)


def write_table(
    table: Table, frame: pd.DataFrame, path: Path, origin: Mapping[str, Any]
) -> None:
    """Write one table atomically as a Parquet file.

    Columns that the schema does not know are kept. Raises DataError if the frame does
    not fit the schema, or the file cannot be written.
    """
    with write_atomically(path) as part:
        _write_parquet(table, frame, part, origin)


def read_table(table: Table, path: Path) -> pd.DataFrame:
    """Read a Parquet file and check it against a schema.

    Raises DataError if the file does not fit; it names the file, the column and the
    remedy.
    """
    if not os.path.exists(path):
        raise DataError(
            path,
            "the file is missing",
            "Restore it, or run the step that makes it again.",
        )
    needed = [column.name for column in table.columns]
    remedy = "Restore it or delete it and run again."
    frame, metadata = file_checks.read_parquet(path, remedy, needed)
    # foreign files have no name
    name = metadata.get(b"table", table.name.encode()).decode()
    if name != table.name:
        raise DataError(
            path,
            f"holds the table '{name}', not '{table.name}'",
            "Put the right file there.",
        )
    return table.check(frame, str(path))


def read_origin(path: Path) -> dict[str, Any]:
    """Read the origin of a Parquet file, or of the first one in a folder.

    It is empty for a file of another program. Raises DataError for a folder without
    tables, a damaged file or a malformed footer.
    """
    if path.is_dir():
        folder, path = path, min(path.glob("*.parquet"), default=path)
        if path == folder:
            raise DataError(folder, "there is no table in it", "Delete the folder.")
    try:
        metadata = file_checks.read_schema(path).metadata or {}
    except READ_ERRORS as error:
        raise DataError(
            path,
            f"not a whole Parquet file ({error})",
            "Restore it or delete it and run again.",
        ) from error
    try:
        origin = json.loads(metadata.get(b"origin", b"{}"))
        Origin.model_validate(origin, strict=True)
    except (ValueError, RecursionError) as error:
        raise DataError(
            path,
            "its footer does not say what made it",
            "Restore the file, or delete it and run again.",
        ) from error
    return dict(origin)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically."""
    with write_atomically(path) as part:
        disk.write(part, content)


def content_hash(path: Path) -> str:
    """Hash a file's content, or a folder's files and their names (SHA-256).

    The hash of a Parquet file covers columns, types and units, not the origin in its
    footer: equal numbers of different runs have equal hashes. For an image that was not
    kept, the digest in the table `frames` is used.
    """
    if path.is_file():
        return _file_hash(path)
    digests = {}
    for file in path.rglob("*"):
        if file.is_file():
            file_checks.require_plain_file(file, file_checks.MAX_TABLE_BYTES)
            digests[file.relative_to(path).as_posix()] = _file_hash(file)
    for name, recorded in _image_digests(path).items():
        digests.setdefault(name, recorded)
    digest = hashlib.sha256()
    for name in sorted(digests):
        digest.update(f"{name}\0{digests[name]}\0".encode())
    return digest.hexdigest()


def _file_hash(file: Path) -> str:
    digest = hashlib.sha256()
    with file.open("rb") as content:
        size = file.stat().st_size
        if file.suffix == ".parquet":
            # layout: pages of the columns, footer, its length (4 bytes), "PAR1"
            schema = file_checks.read_schema(file).remove_metadata()
            digest.update(schema.serialize().to_pybytes())
            end = content.seek(-8, os.SEEK_END)
            size = end - int.from_bytes(content.read(4), "little")
            content.seek(0)
        # a film may exceed the memory
        while size > 0 and (piece := content.read(min(CHUNK_BYTES, size))):
            size -= len(piece)
            digest.update(piece)
    return digest.hexdigest()


def _image_digests(folder: Path) -> dict[str, str]:
    """Return the recorded digests of a trial's images, by file."""
    path = folder / "frames.parquet"
    if not path.is_file():
        return {}
    if DIGEST_COLUMN not in file_checks.read_schema(path).names:
        return {}
    columns = ["file", DIGEST_COLUMN]
    _, texts = file_checks.check_parquet(path, columns)
    if not set(columns) <= set(texts):
        raise DataError(
            path,
            f"the columns {' and '.join(columns)} must hold texts",
            "Restore it.",
        )
    with pq.ParquetFile(path, read_dictionary=columns) as file:
        frames = file.read(columns).to_pandas()
    return dict(zip(frames["file"], frames[DIGEST_COLUMN], strict=True))


def damaged_image(folder: Path) -> str:
    """Return the first image whose digest differs from the recorded one, if any."""
    for name, recorded in _image_digests(folder).items():
        if file_checks.is_file_inside(folder, name):
            file = folder / name
            file_checks.require_plain_file(file, file_checks.MAX_TABLE_BYTES)
            if _file_hash(file) != recorded:
                return name
    return ""


def images_not_kept(folder: Path) -> frozenset[str]:
    """Return the recorded image files of a trial that do not exist any more."""
    names = _image_digests(folder)
    return frozenset(Path(n).name for n in names if not (folder / n).is_file())


def _write_parquet(
    table: Table, frame: pd.DataFrame, path: Path, origin: Mapping[str, Any]
) -> None:
    """Write a table, equal content as equal bytes, and check its row count."""
    checked = table.check(frame, path.name)
    schema = table.arrow_schema(checked)
    metadata = dict(schema.metadata or {})
    metadata[b"origin"] = json.dumps(origin, sort_keys=True).encode()
    content = pa.Table.from_pandas(checked, schema=schema, preserve_index=False)
    buffer = pa.BufferOutputStream()
    pq.write_table(
        content.replace_schema_metadata(metadata), buffer, write_page_checksum=True
    )
    disk.write(path, buffer.getvalue().to_pybytes())
    if pq.read_metadata(path).num_rows != len(checked):
        raise OSError(errno.EIO, "it reads back differently")


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """Yield a temporary name in the same folder; rename it to `path` on success.

    On failure, remove it and keep the former file.
    """
    part = _sibling_name(path)
    try:
        disk.make_folder(path.parent)
        yield part
        _move_into_place(part, path)
        disk.sync_folder(path.parent)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(
            path,
            f"cannot be written ({reason})",
            f"{remedy_for(error)}; nothing half-written is left.",
        ) from error
    finally:
        _remove_leftovers(path)


def _sibling_name(path: Path, role: str = "part") -> Path:
    """Make a new name in the same folder, on the same disk."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.{role}")


def _remove_leftovers(path: Path) -> None:
    """Remove leftovers of failed or killed writes, except the only copy."""
    pattern = re.escape(f".{path.name}.") + r"[0-9a-f]{8}\.(part|replaced)"
    with suppress(OSError):
        for file in path.parent.iterdir():
            match = re.fullmatch(pattern, file.name)
            if match and (match[1] == "part" or path.exists()):
                disk.remove(file)


def _move_into_place(part: Path, path: Path) -> None:
    """Rename `part` to `path`.

    An existing folder is moved away first, as no system replaces a non-empty one.
    """
    if not path.is_dir():
        disk.rename(part, path)
        return
    former = _sibling_name(path, "replaced")
    disk.rename(path, former)
    try:
        disk.rename(part, path)
    except BaseException:
        disk.rename(former, path)
        raise
