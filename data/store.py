"""Writes and reads artifacts, so that nothing half-written is ever read as whole.

An artifact is a folder with one Parquet file for each of its tables, and `images/` for a
trial. It is written into a neighbouring folder, every file closed, read back and synced,
and only then given its name; the name appears whole or not at all. What made a file (its
origin) is in the Parquet footer.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from data.schema import DataError, Table

Artifact = TypeVar("Artifact")
IMAGES = "images"


def save(artifact: Any, folder: Path, origin: Mapping[str, Any]) -> None:
    """Write an artifact as `folder`, replacing one that is there. origin: JSON-able, goes into every footer."""
    with _aside(folder) as aside:
        aside.mkdir()
        for name, table in artifact.TABLES.items():
            _write_parquet(table, getattr(artifact, name), aside / f"{name}.parquet", origin)
        if hasattr(artifact, IMAGES):
            write_images(artifact.images, aside / IMAGES)


def load(kind: type[Artifact], folder: Path) -> Artifact:
    """Read an artifact of `kind`; raises DataError naming the file and the remedy."""
    if not folder.is_dir():
        raise DataError(f"{folder}: there is no {kind.__name__.lower()} here. Name a run folder that holds one.")
    tables: dict[str, Any] = {}
    for name, table in kind.TABLES.items():  # type: ignore[attr-defined]
        tables[name] = read_table(table, folder / f"{name}.parquet")
    if IMAGES in kind.__dataclass_fields__:  # type: ignore[attr-defined]
        tables[IMAGES] = ImageFolder(folder / IMAGES, len(tables["frames"]))
    return kind(**tables)


def write_table(table: Table, frame: pd.DataFrame, path: Path, origin: Mapping[str, Any]) -> None:
    """Write one table as `path`, whole or not at all."""
    with _aside(path) as aside:
        _write_parquet(table, frame, aside, origin)


def read_table(table: Table, path: Path) -> pd.DataFrame:
    """Read and check one table."""
    try:
        frame = pq.ParquetFile(path).read().to_pandas()
    except FileNotFoundError as error:
        raise DataError(f"{path}: the file is missing. Restore it, or run the step that makes it again.") from error
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(
            f"{path}: not a whole Parquet file ({error}). Restore it or delete it and run again."
        ) from error
    return table.check(frame, str(path))


def origin_of(path: Path) -> dict[str, Any]:
    """What made a Parquet file of ours."""
    metadata = pq.read_schema(path).metadata or {}
    return json.loads(metadata.get(b"origin", b"{}"))


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with _aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def content_hash(path: Path) -> str:
    """SHA-256 of a file, or of a folder's files and their names."""
    digest = hashlib.sha256()
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    for file in files:
        digest.update(str(file.relative_to(path)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def write_images(images: Sequence[np.ndarray], folder: Path) -> None:
    """Write frames as 000000.png, 000001.png, ... into a new folder."""
    folder.mkdir()
    for number, image in enumerate(images):
        good, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if not good:
            raise DataError(f"{folder}: frame {number} of shape {image.shape} cannot be written as PNG.")
        (folder / f"{number:06d}.png").write_bytes(png.tobytes())


@dataclass(frozen=True)
class ImageFolder(Sequence[np.ndarray]):
    """The frames of a folder, read one by one."""

    folder: Path
    frames: int

    def __len__(self) -> int:
        """Number of frames."""
        return self.frames

    def __getitem__(self, index: Any) -> Any:
        """One frame (height, width), or a list of them for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self.frames))]
        if not -self.frames <= index < self.frames:
            raise IndexError(index)
        path = self.folder / f"{index % self.frames:06d}.png"
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise DataError(f"{path}: the frame is missing or damaged. Restore it or leave the trial out.")
        return image


def _write_parquet(table: Table, frame: pd.DataFrame, path: Path, origin: Mapping[str, Any]) -> None:
    """Write and read back; the caller gives the file its name."""
    checked = table.check(frame, path.name)
    schema = table.arrow(checked)
    metadata = {**(schema.metadata or {}), b"origin": json.dumps(origin, sort_keys=True, default=str).encode()}
    content = pa.Table.from_pandas(checked, schema=schema, preserve_index=False).replace_schema_metadata(metadata)
    pq.write_table(content, path)
    if pq.read_metadata(path).num_rows != len(checked):
        raise DataError(f"{path}: the file read back differs from what was written. Is the disk sound?")


@contextmanager
def _aside(path: Path) -> Iterator[Path]:
    """A name beside `path` to write to; on success it is synced and becomes `path`."""
    aside = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        _each_file(aside, _sync)
        _replace(aside, path)
        _sync(path.parent)
    except OSError as error:
        raise DataError(
            f"{path}: cannot be written ({error.strerror or error}). Free space or choose a folder."
        ) from error
    finally:
        _remove(aside)


def _replace(aside: Path, path: Path) -> None:
    """Give `aside` its name; an old folder of that name is moved out of the way first."""
    if not path.is_dir():
        os.replace(aside, path)
        return
    old = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.old")
    os.replace(path, old)
    os.replace(aside, path)
    _remove(old)


def _each_file(path: Path, action: Callable[[Path], None]) -> None:
    for file in [*path.rglob("*"), path] if path.is_dir() else [path]:
        action(file)


def _sync(path: Path) -> None:
    """Put a file or folder on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    elif path.exists():
        path.unlink(missing_ok=True)
