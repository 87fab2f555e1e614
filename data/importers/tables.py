"""Tables as logs and trackers write them: CSV with any separator, and Parquet."""

from __future__ import annotations

import csv as lines
from pathlib import Path

import pandas as pd

from stringcast.data.file_checks import (
    MAX_COLUMNS,
    check_csv,
    read_frame,
    read_parquet,
)
from stringcast.data.importers import SourceRecording
from stringcast.data.schema import DataError

SNIFFED_BYTES = 2**14  # [bytes] in which the separator and the headings are detected
TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".parquet")
SEPARATORS = ",;\t|"
EMPTY_TABLE = pd.DataFrame()


def recognises(path: Path) -> bool:
    """Tell whether a file's name ends as a table's."""
    return path.suffix.lower() in TABLE_SUFFIXES


def read(path: Path) -> list[SourceRecording]:
    """Read the table of a file, as one recording.

    Of Parquet the plain columns are read. The first line of a text file that is no
    comment must name its columns. Raises DataError naming the file and the remedy.
    """
    if path.suffix.lower() == ".parquet":
        frame, _ = read_parquet(path, "Write it again.")
        return [SourceRecording(path, frame)]
    with check_csv(path).open(encoding="utf-8-sig", errors="replace") as text:
        head = text.read(SNIFFED_BYTES).splitlines()
    skipped = 0
    for number, line in enumerate(head):
        if line.strip() and not line.lstrip().startswith(("#", "%")):
            skipped = number
            break
    separator, decimal = detect_separator(head[skipped:])
    frame = read_frame(
        path,
        "CSV",
        "Save it as plain text in UTF-8.",
        skiprows=skipped,
        encoding="utf-8-sig",
        engine="c",
        low_memory=False,
        sep=separator,
        decimal=decimal,
        skipinitialspace=separator != r"\s+",
        index_col=False,
    )
    if len(frame.columns) > MAX_COLUMNS:
        raise DataError(
            f"{path}: it has {len(frame.columns)} columns, at most {MAX_COLUMNS} are "
            "read. Take some out."
        )
    names = [str(name).strip() for name in frame.columns]
    if all(map(_is_number, names)):
        raise DataError(
            f"{path}: its first line names no columns, it holds numbers: "
            f"{', '.join(names[:4])}. Put a line above it such as "
            "time_s,joint1_deg,joint2_deg,joint3_deg or time_s,tip_x_mm,tip_y_mm."
        )
    return [SourceRecording(path, frame.set_axis(names, axis=1))]


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
