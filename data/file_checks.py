"""Checks of foreign files before they are read.

No file may block the reader, fill the memory or run code.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any, ClassVar
from warnings import catch_warnings, simplefilter

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from pandas.errors import ParserWarning

from stringcast.data.schema import DataError

# [bytes] of settings: ours have 10 kB, and YAML parses 1 MB in a second
MAX_TEXT_BYTES = 2**20
# [bytes] of a table: 11 points at 240 frames a second for an hour
MAX_TABLE_BYTES = 2**28
# [bytes] of a Parquet footer: ours have at most 4e6
MAX_FOOTER_BYTES = 2**24
MAX_CSV_BYTES = 2**26  # [bytes]; memory use is up to ten times as large
NUMBER_BYTES = 8  # [bytes] of a number
# of a table: ours have at most 30; pandas takes a minute for two million
MAX_COLUMNS = 1000
MAX_HEADER_BYTES = 2**16  # [bytes] of the first line of a CSV file: 64 for each column
MAX_DIGITS = 40  # of an integer: twice as many as the largest int64
# pixels: the largest sensors have 5e7, or 0.2 GB in three colours
MAX_PIXELS = 1 << 26
# CSV cells of a missing number; in text columns, NA is a name
MISSING_CELLS = [
    "",
    "NA",
    "N/A",
    "n/a",
    "#N/A",
    "#NA",
    "<NA>",
    "NaN",
    "nan",
    "-NaN",
    "-nan",
    "NULL",
    "null",
    "None",
    "1.#IND",
    "-1.#IND",
    "1.#QNAN",
]
# end mark of YAML that we write, as a truncated file is often valid YAML
YAML_BEGINNING = "# A whole copy of this file has the line '# end'."
YAML_END = "# end"
READ_ERRORS = (pa.ArrowException, OSError, ValueError)  # of a damaged file
# tags of YAML values that are not allowed
REFUSED_YAML_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("set", "omap", "pairs", "binary")
}


def require_plain_file(path: Path, max_bytes: int | None = None) -> Path:
    """Require a plain file of at most `max_bytes` and return its path.

    A pipe would block the reader; a device may never end.
    """
    try:
        status = path.stat()
    except FileNotFoundError as error:
        raise DataError(
            path,
            "there is no such file",
            "Restore it, or look at its name.",
        ) from error
    except OSError as error:
        raise DataError(
            path,
            f"cannot be read ({error.strerror})",
            "Restore it, or look at its permissions.",
        ) from error
    if not stat.S_ISREG(status.st_mode):
        raise DataError(
            path,
            "it is no plain file (a folder, a pipe or a device)",
            "Put a file there.",
        )
    if max_bytes is not None and status.st_size > max_bytes:
        raise DataError(
            path,
            f"it has {status.st_size} bytes, at most {max_bytes} are read",
            "Make it smaller, or split it.",
        )
    return path


def require_inside(folder: Path, path: Path) -> Path:
    """Require a plain file in this folder, links followed, and return its path.

    A link could reveal a private file elsewhere.
    """
    if not require_plain_file(path).resolve().is_relative_to(folder.resolve()):
        raise DataError(
            path,
            f"it is a link that leaves the folder {folder}",
            "Put the file itself there.",
        )
    return path


def is_file_inside(folder: Path, file: str) -> bool:
    """Return whether a path read from a file is a plain file in this folder."""
    path = folder / file
    return os.path.isfile(path) and path.resolve().is_relative_to(folder.resolve())


def is_outside(folder: Path, file: str) -> bool:
    """Return whether a path read from a file leaves this folder, links followed."""
    if "\0" in file:
        return False
    path = Path(os.path.realpath(folder / file))
    return not path.is_relative_to(folder.resolve())


def mark_yaml_end(text: str) -> str:
    """Append an end mark, so that a truncated copy is noticed."""
    return f"{YAML_BEGINNING}\n{text}{YAML_END}\n"


def read_yaml(path: Path) -> dict[str, Any]:
    """Read the names and plain values of a YAML file.

    Raises DataError naming the file and the remedy.
    """
    values = _read_mapping(path, _parse_yaml, "not valid YAML")
    return refuse_interpolation(values, path)


def _parse_yaml(text: str) -> Any:
    """Parse YAML; refuse our own files without their end mark."""
    lines = text.splitlines()
    if YAML_BEGINNING in lines and YAML_END not in lines:
        raise ValueError(f"it was cut: the line '{YAML_END}' is missing")
    return yaml.load(text, _StrictLoader)


def read_json(path: Path) -> dict[str, Any]:
    """Read the names and values of a JSON file.

    Raises DataError naming the file and the remedy.
    """
    return _read_mapping(path, json.loads, "damaged")


def _read_mapping(
    path: Path, parse: Callable[[str], Any], fault: str
) -> dict[str, Any]:
    try:
        values = parse(
            require_plain_file(path, MAX_TEXT_BYTES).read_text(encoding="utf-8")
        )
    except UnicodeDecodeError as error:
        raise DataError(
            path,
            f"it is not text in UTF-8 ({error})",
            "Save it as UTF-8.",
        ) from error
    except (yaml.YAMLError, ValueError, OSError) as error:
        reason, line = " ".join(str(error).split()), ""
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark:
            line = f"line {error.problem_mark.line + 1}"
            reason = f"{line}: {error.problem}"
        remedy = "Correct it there, or restore it."
        raise DataError(path, f"{fault} ({reason})", remedy, line) from error
    except RecursionError as error:
        raise DataError(
            path, "its blocks are nested too deeply", "Make it flat."
        ) from error
    if values is not None and not isinstance(values, dict):
        raise DataError(
            path,
            "it must hold names and values, like 'format: 1'",
            "Correct it.",
        )
    return values or {}


def refuse_interpolation(values: dict[str, Any], path: Path) -> dict[str, Any]:
    """Require values without Hydra interpolations, and return them."""
    place = _interpolated_key(values)
    if place:
        raise DataError(
            path,
            f"{place} holds '${{', which would be looked up elsewhere",
            "Write the value itself.",
        )
    return values


class _StrictLoader(yaml.SafeLoader):
    """YAML without aliases of lists and blocks, and without repeated names.

    Nine lines of aliases can expand to 1e9 values. Repeated names would silently lose
    all values but the last.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node; refuse an alias of a list or a block."""
        if self.check_event(yaml.AliasEvent):
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            if not isinstance(self.anchors.get(event.anchor), yaml.ScalarNode):
                raise yaml.YAMLError(
                    f"*{event.anchor} stands for a list or a block, which is refused"
                    f"{event.start_mark}"
                )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Construct a block; refuse a name that is given twice."""
        names = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in names:
                    raise yaml.YAMLError(f"{key.value} is given twice{key.start_mark}")
                names.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> Any:
        """Construct an integer with a limited number of digits."""
        if len(node.value) > MAX_DIGITS:
            raise yaml.YAMLError(
                f"a whole number of {len(node.value)} digits{node.start_mark}"
            )
        return super().construct_yaml_int(node)

    yaml_constructors: ClassVar[dict[str | None, Any]] = {
        tag: constructor
        for tag, constructor in yaml.SafeLoader.yaml_constructors.items()
        if tag not in REFUSED_YAML_TAGS
    } | {
        "tag:yaml.org,2002:int": construct_yaml_int,
        # dates stay texts
        "tag:yaml.org,2002:timestamp": yaml.SafeLoader.construct_yaml_str,
    }


def _interpolated_key(value: Any, place: str = "") -> str:
    """Name the key of the first interpolation, such as ${oc.env:HOME}.

    The name is empty if there is none.
    """
    if isinstance(value, str):
        return place if "${" in value else ""
    if isinstance(value, dict):
        items: Iterable[tuple[Any, Any]] = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    else:
        return ""
    for name, inner in items:
        live = _interpolated_key(name, place or "a name")
        live = live or _interpolated_key(inner, f"{place}.{name}".lstrip("."))
        if live:
            return live
    return ""


def check_csv(path: Path) -> Path:
    """Require a CSV file that fits into memory and has a heading; return its path."""
    with require_plain_file(path, MAX_CSV_BYTES).open("rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    if len(head) == MAX_HEADER_BYTES and b"\n" not in head and b"\r" not in head:
        raise DataError(
            path,
            "its first line does not end",
            "It must hold the columns' names, with commas.",
        )
    return path


def begins_with(path: Path, text: str, encoding: str) -> bool:
    """Return whether a path is a file whose content begins with a text."""
    if not path.is_file():
        return False
    with path.open(encoding=encoding, errors="replace") as file:
        return file.read(len(text)) == text


def read_frame(path: Path, kind: str, remedy: str, **options: Any) -> pd.DataFrame:
    """Read a CSV file with the options of `pandas.read_csv`.

    Raises DataError naming the kind of file and the remedy. Rows may end with a
    separator, but not with values for which there is no column: pandas would lose them.
    """
    try:
        with catch_warnings(record=True) as caught:
            simplefilter("always")
            frame = pd.read_csv(path, **options)
        if any(issubclass(warning.category, ParserWarning) for warning in caught):
            _refuse_unnamed_values(path, frame.shape[1], options)
        return frame
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())
        raise DataError(path, f"cannot be read as {kind} ({reason})", remedy) from error


def _refuse_unnamed_values(path: Path, named: int, options: dict[str, Any]) -> None:
    """Raise DataError for a CSV file whose rows hold more values than columns."""
    dialect = ("sep", "encoding", "skipinitialspace")
    rows = pd.read_csv(
        path,
        header=None,
        skiprows=options.get("skiprows", 0) + 1,
        **{name: options[name] for name in dialect if name in options},
    )
    if rows.iloc[:, named:].notna().any(axis=None):
        raise DataError(
            path,
            f"its rows hold {rows.shape[1]} values, its first line names {named} "
            "columns",
            "Name all columns. Decimals need a point, or semicolons between the "
            "columns.",
        )


def text_options(names: Iterable[str], texts: Collection[str]) -> dict[str, Any]:
    """Return options of `read_frame` that keep some columns as texts, as in NA and 01.

    `names` are all columns. In columns of text, only an empty cell is missing.
    """
    missing = {}
    kinds = {}
    for name in names:
        missing[name] = [""] if name in texts else MISSING_CELLS
        if name in texts:
            kinds[name] = str
    return {"keep_default_na": False, "na_values": missing, "dtype": kinds}


def read_parquet(
    path: Path, remedy: str, needed: Collection[str] = ()
) -> tuple[pd.DataFrame, dict[bytes, bytes]]:
    """Check a Parquet file; return its columns of single values and its metadata.

    `remedy` says what to do about a damaged file; `needed` columns must hold one value
    per row. Raises DataError if the file is damaged or does not fit into memory.
    """
    try:
        columns, texts = check_parquet(path, needed)
        with pq.ParquetFile(
            path, page_checksum_verification=True, read_dictionary=texts
        ) as file:
            metadata = file.schema_arrow.metadata or {}
            frame = file.read(columns).to_pandas()
        # a column of texts may have become the index
        return frame.astype({text: object for text in texts if text in frame}), metadata
    except READ_ERRORS as error:
        raise DataError(path, f"not a whole Parquet file ({error})", remedy) from error


def read_schema(path: Path) -> pa.Schema:
    """Read the schema of a Parquet file, unless its footer is too large.

    The last eight bytes are the length of the footer (4 bytes) and "PAR1".
    """
    with require_plain_file(path).open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - 8, 0))
        length, magic = int.from_bytes(file.read(4), "little"), file.read(4)
    if magic == b"PAR1" and length > MAX_FOOTER_BYTES:
        raise DataError(
            path,
            f"its footer has {length} bytes, at most {MAX_FOOTER_BYTES} are read",
            "Restore the file, or write it again.",
        )
    return pq.read_schema(path)


def check_parquet(path: Path, needed: Collection[str]) -> tuple[list[str], list[str]]:
    """Check a Parquet file; list its columns of single values, and those of texts.

    A few bytes may encode 4e8 rows, or the same text of 1 MB in each row. Read texts as
    dictionaries for that reason. Raises DataError if the file does not fit into memory,
    or a `needed` column is nested.
    """
    schema = read_schema(path)
    with pq.ParquetFile(path) as file:
        metadata = file.metadata
    stored = 0
    for group in range(metadata.num_row_groups):
        stored += metadata.row_group(group).total_byte_size
    size = max(stored, metadata.num_rows * metadata.num_columns * NUMBER_BYTES)
    if size > MAX_TABLE_BYTES:
        raise DataError(
            path,
            f"{metadata.num_rows} rows of {metadata.num_columns} columns would "
            f"take {size / 1e9:.1f} GB, at most "
            f"{MAX_TABLE_BYTES / 1e9:.1f} are read",
            "Split it into datasets of fewer trials.",
        )
    if len(schema) > MAX_COLUMNS:
        raise DataError(
            path,
            f"it has {len(schema)} columns, at most {MAX_COLUMNS} are read",
            "Leave out the others.",
        )
    names = []
    texts = []
    for column in schema:
        name, kind = column.name, column.type
        if schema.names.count(name) > 1:
            raise DataError(
                path,
                f"it has the column '{name}' twice",
                "Leave one out.",
                field=name,
            )
        if not pa.types.is_nested(kind):
            names.append(name)
            if pa.types.is_string(kind) or pa.types.is_binary(kind):
                texts.append(name)
        elif name in needed:
            raise DataError(
                path,
                f"column '{name}' holds {kind}, not a value a row",
                "Store plain columns.",
                field=name,
            )
    return names, texts
