"""Files that others made: each is looked at before it is read, so that none blocks,
fills the memory or runs on.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Collection
from pathlib import Path
from typing import Any, ClassVar

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from stringcast.data.schema import DataError

# [bytes] of settings: ours have 10 kB, and YAML takes a second for a hundred times that
MAX_TEXT_BYTES = 2**20
MAX_TABLE_BYTES = (
    2**28
    # [bytes] of a table: an hour of 11 points at 240 frames a second has 2**28, and
    # what reads it, twice
)
MAX_CSV_BYTES = 2**26  # [bytes]: in memory, as numbers and names, up to ten times that
NUMBER_BYTES = 8  # [bytes] of a number
# of a table: ours have at most 30, and pandas takes a minute to tell two million apart
MAX_COLUMNS = 1000
# [bytes] of the first line of a CSV file: 64 for each of so many names
MAX_HEADER_BYTES = 2**16
MAX_DIGITS = 40  # of a whole number: twice those of the largest that a table holds
# no kinds of settings
REFUSED_YAML_TAGS = [
    f"tag:yaml.org,2002:{kind}" for kind in ("set", "omap", "pairs", "binary")
]
# of an image: the largest sensors have 5e7, and a byte each, in three colours, takes
# 0.2 GB
MAX_PIXELS = 1 << 26


def require_plain_file(path: Path, most: int | None = None) -> Path:
    """The path, if it is a plain file of at most `most` bytes: a pipe blocks its
    reader, a device may never end.
    """
    try:
        about = path.stat()
    except FileNotFoundError as error:
        raise DataError(
            f"{path}: there is no such file. Restore it, or look at its name."
        ) from error
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror}). Restore it, or look at its permissions."
        ) from error
    if not stat.S_ISREG(about.st_mode):
        raise DataError(
            f"{path}: it is no plain file (a folder, a pipe or a device). Put a file there."
        )
    if most is not None and about.st_size > most:
        raise DataError(
            f"{path}: it has {about.st_size} bytes, at most {most} are read. Make it smaller, or split it."
        )
    return path


def require_inside(folder: Path, path: Path) -> Path:
    """The path, if it is a plain file that lies in this folder, links followed: one
    elsewhere is another's to show.
    """
    if not require_plain_file(path).resolve().is_relative_to(folder.resolve()):
        raise DataError(
            f"{path}: it is a link that leaves the folder {folder}. Put the file itself there."
        )
    return path


def is_file_inside(folder: Path, file: str) -> bool:
    """Whether a path that a file names is a plain file in this folder, links followed."""
    whole = folder / file
    return os.path.isfile(whole) and whole.resolve().is_relative_to(folder.resolve())


def is_outside(folder: Path, file: str) -> bool:
    """Whether a path that a file names lies outside this folder, links followed, be
    there a file or not.
    """
    return "\0" not in file and not Path(
        os.path.realpath(folder / file)
    ).is_relative_to(folder.resolve())


def read_yaml(path: Path) -> dict[str, Any]:
    """The names and values of a YAML file: plain values only. Raises DataError naming
    the file and the remedy.
    """
    return refuse_interpolation(
        _read_mapping(path, yaml.load, _StrictLoader, "not valid YAML"), path
    )


def read_json(path: Path) -> dict[str, Any]:
    """The names and values of a JSON file. Raises DataError naming the file and the
    remedy.
    """
    return _read_mapping(path, lambda text, kind: json.loads(text), None, "damaged")


def _read_mapping(path: Path, parse: Any, kind: Any, fault: str) -> dict[str, Any]:
    try:
        known = parse(
            require_plain_file(path, MAX_TEXT_BYTES).read_text(encoding="utf-8"), kind
        )
    except UnicodeDecodeError as error:
        raise DataError(
            f"{path}: it is not text in UTF-8 ({error}). Save it as UTF-8."
        ) from error
    except (yaml.YAMLError, ValueError, OSError) as error:
        mark, problem = (
            getattr(error, "problem_mark", None),
            getattr(error, "problem", ""),
        )
        where = (
            " ".join(str(error).split())
            if mark is None
            else f"line {mark.line + 1}: {problem}"
        )
        raise DataError(
            f"{path}: {fault} ({where}). Correct it there, or restore it."
        ) from error
    except RecursionError as error:
        raise DataError(
            f"{path}: its blocks lie too deep in one another. Make it flat."
        ) from error
    if known is not None and not isinstance(known, dict):
        raise DataError(
            f"{path}: it must hold names and values, like 'format: 1'. Correct it."
        )
    return known or {}


def refuse_interpolation(known: dict[str, Any], path: Path) -> dict[str, Any]:
    """Names and values of a file that become settings. Raises DataError for text that
    Hydra would resolve.
    """
    place = _interpolated_key(known)
    if place:
        raise DataError(
            f"{path}: {place} holds '${{', which would be looked up elsewhere. Write the value itself."
        )
    return known


class _StrictLoader(yaml.SafeLoader):
    """YAML without aliases of lists and blocks, nine lines of which can stand for 1e9
    values, and without a name that is given twice, the first of which would be lost in
    silence.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        """A node, as yaml composes it."""
        event: Any = self.check_event(yaml.AliasEvent) and self.peek_event()
        if event and not isinstance(self.anchors.get(event.anchor), yaml.ScalarNode):
            raise yaml.YAMLError(
                f"*{event.anchor} stands for a list or a block, which is not taken{event.start_mark}"
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """A block, as yaml makes it."""
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.YAMLError(f"{key.value} is given twice{key.start_mark}")
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else None)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> Any:
        """A whole number, as yaml makes it: Python cannot print those of thousands of
        digits.
        """
        if len(node.value) > MAX_DIGITS:
            raise yaml.YAMLError(
                f"a whole number of {len(node.value)} digits{node.start_mark}"
            )
        return super().construct_yaml_int(node)

    yaml_constructors: ClassVar[dict[str | None, Any]] = {
        **{
            tag: made
            for tag, made in yaml.SafeLoader.yaml_constructors.items()
            if tag not in REFUSED_YAML_TAGS
        },
        "tag:yaml.org,2002:int": construct_yaml_int,
        # as it stands there
        "tag:yaml.org,2002:timestamp": yaml.SafeLoader.construct_yaml_str,
    }


def _interpolated_key(value: Any, place: str = "") -> str:
    """The name of the first text that Hydra would resolve, such as ${oc.env:HOME};
    empty if there is none.
    """
    if isinstance(value, str):
        return place if "${" in value else ""
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    found = (
        _interpolated_key(name, place or "a name")
        or _interpolated_key(inner, f"{place}.{name}".lstrip("."))
        for name, inner in items
    )
    return next(filter(None, found), "")


def check_csv(path: Path) -> Path:
    """The path of a CSV file that fits into memory and whose first line may name
    columns.
    """
    with require_plain_file(path, MAX_CSV_BYTES).open("rb") as file:
        begins = file.read(MAX_HEADER_BYTES)
    if len(begins) == MAX_HEADER_BYTES and not {*b"\r\n"} & {*begins}:
        raise DataError(
            f"{path}: its first line does not end. It must hold the columns' names, with commas."
        )
    return path


def check_parquet(path: Path, needed: Collection[str]) -> tuple[list[str], list[str]]:
    """The columns of a Parquet file that hold a value a row, and those of them that
    hold texts or bytes; raises DataError for one that does not fit into memory (a few
    bytes may stand for 4e8 rows) or `needed` ones that hold more.

    Texts are to be read as dictionaries, for a few bytes may also say that each row
    repeats a text of 1 MB.
    """
    with pq.ParquetFile(require_plain_file(path)) as file:
        about, schema = file.metadata, file.schema_arrow
        groups = sum(
            about.row_group(i).total_byte_size for i in range(about.num_row_groups)
        )
        size = max(groups, about.num_rows * about.num_columns * NUMBER_BYTES)
    if size > MAX_TABLE_BYTES:
        raise DataError(
            f"{path}: {about.num_rows} rows of {about.num_columns} columns would take {size / 1e9:.1f} GB, at most "
            f"{MAX_TABLE_BYTES / 1e9:.1f} are read. Split it into datasets of fewer trials."
        )
    if len(schema) > MAX_COLUMNS:
        raise DataError(
            f"{path}: it has {len(schema)} columns, at most {MAX_COLUMNS} are read. Leave out the others."
        )
    twice = next((name for name in schema.names if schema.names.count(name) > 1), None)
    if twice is not None:
        raise DataError(f"{path}: it has the column '{twice}' twice. Leave one out.")
    nested = {
        field.name: field.type for field in schema if pa.types.is_nested(field.type)
    }
    for name in needed:
        if name in nested:
            raise DataError(
                f"{path}: column '{name}' holds {nested[name]}, not a value a row. Store plain columns."
            )
    whole = [field for field in schema if field.name not in nested]
    texts = [
        field.name
        for field in whole
        if pa.types.is_string(field.type) or pa.types.is_binary(field.type)
    ]
    return [field.name for field in whole], texts
