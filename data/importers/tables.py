"""Tables as logs and trackers write them: CSV with any separator, and Parquet."""

from __future__ import annotations

import csv as lines
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data.file_checks import MAX_COLUMNS, check_csv, check_parquet
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

SNIFFED_BYTES = 2**14  # [bytes] from which separator and headings are told
TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".parquet")
SEPARATORS = ",;\t|"
EMPTY_TABLE = pd.DataFrame()


def reads(path: Path) -> bool:
    """Whether a file's name ends as a table's."""
    return path.suffix.lower() in TABLE_SUFFIXES


def read(path: Path) -> list[SourceRecording]:
    """The table of a file, one recording: the plain columns of Parquet, or numbers and
    texts of a text file whose first line that is no comment names its columns. Raises
    DataError naming the file and the remedy.
    """
    if path.suffix.lower() == ".parquet":
        try:
            columns, texts = check_parquet(path, [])
            with pq.ParquetFile(path, read_dictionary=texts) as file:
                return [
                    SourceRecording(
                        path,
                        file.read(columns)
                        .to_pandas()
                        .astype(dict.fromkeys(texts, object)),
                    )
                ]
        except (pa.ArrowException, OSError, ValueError) as error:
            raise DataError(
                f"{path}: not a whole Parquet file ({error}). Write it again."
            ) from error
    with check_csv(path).open(encoding="utf-8-sig", errors="replace") as text:
        head = text.read(SNIFFED_BYTES).splitlines()
    skipped = next(
        (
            n
            for n, line in enumerate(head)
            if line.strip() and not line.lstrip().startswith(("#", "%"))
        ),
        0,
    )
    separator, decimal = detect_separator(head[skipped:])
    how = {
        "sep": separator,
        "decimal": decimal,
        "skipinitialspace": separator != r"\s+",
        "index_col": False,
    }
    try:
        frame = pd.read_csv(
            path,
            skiprows=skipped,
            encoding="utf-8-sig",
            engine="c",
            low_memory=False,
            **how,
        )
    except (ValueError, OSError) as error:
        raise DataError(
            f"{path}: cannot be read as CSV ({error}). Save it as plain text in UTF-8."
        ) from error
    if len(frame.columns) > MAX_COLUMNS:
        raise DataError(
            f"{path}: it has {len(frame.columns)} columns, at most {MAX_COLUMNS} are read. Take some out."
        )
    names = [str(name).strip() for name in frame.columns]
    if all(_is_number(name) for name in names):
        raise DataError(
            f"{path}: its first line names no columns, it holds numbers: {', '.join(names[:4])}. Put a line above it "
            "such as time_s,joint1_deg,joint2_deg,joint3_deg or time_s,tip_x_mm,tip_y_mm."
        )
    return [SourceRecording(path, frame.set_axis(names, axis=1))]


def detect_separator(head: list[str]) -> tuple[str, str]:
    """The separator of columns and the decimal mark, from the first lines."""
    first, *rest = head or [""]
    counts = {mark: first.count(mark) for mark in SEPARATORS}
    mark = max(counts, key=lambda m: counts[m])
    if not counts[mark]:
        return (r"\s+" if len(first.split()) > 1 else ","), "."
    cells = [
        cell
        for line in rest[:20]
        for cell in next(lines.reader([line], delimiter=mark), [])
    ]
    commas = (
        mark != ","
        and sum(_is_number(cell.replace(",", ".", 1)) and "," in cell for cell in cells)
        > 0
    )
    return mark, "," if commas else "."


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
