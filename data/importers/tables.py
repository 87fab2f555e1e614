"""Tables as logs and trackers write them: CSV with any separator, and Parquet."""

from __future__ import annotations

import csv as lines
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from stringcast.data.foreign import MOST_COLUMNS, csv, parquet
from stringcast.data.importers import Recording
from stringcast.data.schema import DataError

HEAD = 2**14  # [bytes] from which separator and headings are told
ENDINGS = (".csv", ".tsv", ".txt", ".log", ".parquet")
SEPARATORS = ",;\t|"
NOTHING = pd.DataFrame()


def reads(path: Path) -> bool:
    """Whether a file's name ends as a table's."""
    return path.suffix.lower() in ENDINGS


def read(path: Path) -> list[Recording]:
    """The table of a file, one recording: the plain columns of Parquet, or numbers and texts of a text file whose first
    line that is no comment names its columns. Raises DataError naming the file and the remedy."""
    if path.suffix.lower() == ".parquet":
        try:
            columns, texts = parquet(path, [])
            with pq.ParquetFile(path, read_dictionary=texts) as file:
                return [Recording(path, file.read(columns).to_pandas().astype(dict.fromkeys(texts, object)))]
        except (pa.ArrowException, OSError, ValueError) as error:
            raise DataError(f"{path}: not a whole Parquet file ({error}). Write it again.") from error
    with csv(path).open(encoding="utf-8-sig", errors="replace") as text:
        head = text.read(HEAD).splitlines()
    skipped = next((n for n, line in enumerate(head) if line.strip() and not line.lstrip().startswith(("#", "%"))), 0)
    separator, decimal = separated(head[skipped:])
    how = {"sep": separator, "decimal": decimal, "skipinitialspace": separator != r"\s+", "index_col": False}
    try:
        frame = pd.read_csv(path, skiprows=skipped, encoding="utf-8-sig", engine="c", low_memory=False, **how)
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: cannot be read as CSV ({error}). Save it as plain text in UTF-8.") from error
    if len(frame.columns) > MOST_COLUMNS:
        raise DataError(f"{path}: it has {len(frame.columns)} columns, at most {MOST_COLUMNS} are read. Take some out.")
    names = [str(name).strip() for name in frame.columns]
    if all(_is_number(name) for name in names):
        raise DataError(
            f"{path}: its first line names no columns, it holds numbers: {', '.join(names[:4])}. Put a line above it "
            "such as time_s,joint1_deg,joint2_deg,joint3_deg or time_s,tip_x_mm,tip_y_mm."
        )
    return [Recording(path, frame.set_axis(names, axis=1))]


def separated(head: list[str]) -> tuple[str, str]:
    """The separator of columns and the decimal mark, from the first lines."""
    first, *rest = head or [""]
    counts = {mark: first.count(mark) for mark in SEPARATORS}
    mark = max(counts, key=lambda m: counts[m])
    if not counts[mark]:
        return (r"\s+" if len(first.split()) > 1 else ","), "."
    cells = [cell for line in rest[:20] for cell in next(lines.reader([line], delimiter=mark), [])]
    commas = mark != "," and sum(_is_number(cell.replace(",", ".", 1)) and "," in cell for cell in cells) > 0
    return mark, "," if commas else "."


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
