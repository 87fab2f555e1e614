"""Tables of logs and trackers: CSV with any separator, and Parquet."""

from __future__ import annotations

import csv as lines
import re
from pathlib import Path
from typing import Any

from stringcast.data.file_checks import (
    MAX_COLUMNS,
    check_csv,
    read_frame,
    read_parquet,
    text_options,
)
from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import column_meaning
from stringcast.data.schema import DataError

SNIFFED_BYTES = 2**14  # [bytes] used to detect separator and headings
TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".parquet")
SEPARATORS = ",;\t|"


def recognises(path: Path) -> bool:
    """Return whether a file has the suffix of a table."""
    return path.suffix.lower() in TABLE_SUFFIXES


def read(path: Path) -> list[SourceRecording]:
    """Read the table of a file, as one recording.

    From Parquet, plain columns are read. The first line of a text file after comments
    must name its columns. Raises DataError naming the file and the remedy.
    """
    if path.suffix.lower() == ".parquet":
        frame, _ = read_parquet(path, "Write it again.")
        return [SourceRecording(path, frame)]
    options = _csv_options(path)
    remedy = "Save it as plain text in UTF-8."
    heading = read_frame(path, "CSV", remedy, nrows=0, **options).columns
    trials = [n for n in heading if column_meaning(str(n).strip()).kind == "trial"]
    options |= text_options(heading, trials)
    frame = read_frame(path, "CSV", remedy, engine="c", low_memory=False, **options)
    for name in trials:
        frame[name] = frame[name].map(_trial_name)
    names = [str(name).strip() for name in frame.columns]
    _refuse_no_table(path, names, len(frame))
    return [SourceRecording(path, frame.set_axis(names, axis=1))]


def _csv_options(path: Path) -> dict[str, Any]:
    """Detect options of `pandas.read_csv` from the first lines of a file."""
    with check_csv(path).open(encoding="utf-8-sig", errors="replace") as text:
        head = text.read(SNIFFED_BYTES).splitlines()
    if not any(line.strip() for line in head):
        raise DataError(path, "it is empty", "Export it again, or leave it out.")
    skipped = 0
    for number, line in enumerate(head):
        if line.strip() and not line.lstrip().startswith(("#", "%")):
            skipped = number
            break
    separator, decimal = detect_separator(head[skipped:])
    return {
        "skiprows": skipped,
        "encoding": "utf-8-sig",
        "sep": separator,
        "decimal": decimal,
        "skipinitialspace": separator != r"\s+",
        "index_col": False,
    }


def _refuse_no_table(path: Path, names: list[str], row_count: int) -> None:
    """Refuse a file with too many columns, without rows, or without a heading."""
    if len(names) > MAX_COLUMNS:
        raise DataError(
            path,
            f"it has {len(names)} columns, at most {MAX_COLUMNS} are read",
            "Take some out.",
        )
    if row_count == 0:
        raise DataError(
            path,
            "it names columns and has no rows",
            "Export it again, or leave it out.",
        )
    if all(map(_is_number, names)):
        raise DataError(
            path,
            "its first line names no columns, it holds numbers: "
            f"{', '.join(names[:4])}",
            "Put a line above it such as "
            "time_s,joint1_deg,joint2_deg,joint3_deg or "
            "time_s,tip_x_mm,tip_y_mm.",
        )


def _trial_name(cell: object) -> object:
    """Return a cell as the name of a trial; 1.0 becomes 1."""
    if not isinstance(cell, str):
        return cell
    return re.sub(r"^(\d+)\.0+$", r"\1", cell.strip())


def detect_separator(head: list[str]) -> tuple[str, str]:
    """Detect the separator of columns and the decimal mark from the first lines."""
    first = head[0] if head else ""
    separator = max(SEPARATORS, key=first.count)
    if separator not in first:
        return (r"\s+" if len(first.split()) > 1 else ","), "."
    if separator == ",":
        return separator, "."
    for line in head[1:21]:
        for cell in next(lines.reader([line], delimiter=separator), []):
            if "," in cell and _is_number(cell.replace(",", ".", 1)):
                return separator, ","
    return separator, "."


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
