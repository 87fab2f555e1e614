"""Tables of logs and trackers: CSV with any separator, and Parquet."""

from __future__ import annotations

import csv as lines
import re
from pathlib import Path
from typing import Any

import pandas as pd

from stringcast.data.file_checks import (
    MAX_COLUMNS,
    check_csv,
    read_frame,
    read_parquet,
    text_options,
)
from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import TIME_UNITS, column_meaning, split_words
from stringcast.data.schema import DataError

SNIFFED_BYTES = 2**14  # [bytes] used to detect separator and headings
TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".log", ".parquet")
SEPARATORS = ",;\t|"
COMMENT_MARKS = ("#", "%")
COMMENT_SIGNS = "#% "  # before the names of columns


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
        frame = join_split_stamps(_with_index(frame))
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
    frame = join_split_stamps(frame.set_axis(names, axis=1))
    return [SourceRecording(path, frame)]


def _with_index(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with its index as a column, if that has a name or holds times."""
    index = frame.index
    is_time = isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex)
    name = index.name or ("time" if is_time else None)
    if name is None or name in frame:
        return frame
    return frame.rename_axis(name).reset_index()


def join_split_stamps(frame: pd.DataFrame) -> pd.DataFrame:
    """Join time stamps that are split into whole seconds and a fraction, as in ROS.

    The names differ in their unit only, such as `stamp.sec` and `stamp.nanosec`.
    """
    fraction_of: dict[str, tuple[str, str]] = {}
    whole_of: dict[str, str] = {}
    for name in map(str, frame):
        words = split_words(name)
        units = [word for word in words if word in TIME_UNITS]
        if column_meaning(name).kind != "time" or len(units) != 1:
            continue
        key = " ".join(word for word in words if word not in units)
        if TIME_UNITS[units[0]] == 1.0:
            whole_of[key] = name
        else:
            fraction_of[key] = name, units[0]
    for key, whole in whole_of.items():
        if key not in fraction_of:
            continue
        fraction, unit = fraction_of[key]
        seconds = pd.to_numeric(frame[whole], errors="coerce")
        parts = pd.to_numeric(frame[fraction], errors="coerce")
        count = round(1 / TIME_UNITS[unit])  # of parts in a second
        known = seconds.notna() & parts.notna()
        is_whole = (seconds[known] % 1 == 0).all()
        if not known.any() or not is_whole or not parts[known].between(0, count).all():
            continue
        joined = frame[[whole]].set_axis(
            [f"time: {whole}, {fraction} [{unit}]"], axis=1
        )
        joined[joined.columns[0]] = seconds * count + parts
        rest = frame.drop(columns=[whole, fraction])
        return pd.concat([joined, rest], axis=1)
    return frame


def _csv_options(path: Path) -> dict[str, Any]:
    """Detect options of `pandas.read_csv` from the first lines of a file."""
    encoding = _detect_encoding(check_csv(path))
    with path.open(encoding=encoding, errors="replace") as text:
        head = text.read(SNIFFED_BYTES).splitlines()
    if not any(line.strip() for line in head):
        raise DataError(path, "it is empty", "Export it again, or leave it out.")
    skipped = find_heading(head)
    separator, decimal = detect_separator(head[skipped:])
    options: dict[str, Any] = {}
    if _is_comment(head[skipped]):
        options = {"header": None, "names": _cells(head[skipped])}
        skipped += 1
    return options | {
        "skiprows": skipped,
        "encoding": encoding,
        "sep": separator,
        "decimal": decimal,
        "skipinitialspace": separator != r"\s+",
        "index_col": False,
    }


def _detect_encoding(path: Path) -> str:
    """Detect UTF-16 by its first bytes, and Windows-1252 as what is no UTF-8."""
    content = path.read_bytes()
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def find_heading(head: list[str]) -> int:
    """Return the number of lines above the one that names the columns.

    Comments and properties of the recording may stand above it. It has as many cells
    as the first line of numbers, and is the first such line, or else the last comment:
    ROS writes `%time,field.x`, NumPy `# t, x`.
    """
    filled = [number for number, line in enumerate(head) if line.strip()]
    texts = [number for number in filled if not _is_comment(head[number])]
    comments = [number for number in filled if _is_comment(head[number])]
    for number in texts:
        cells = _cells(head[number])
        numeric = [cell for cell in cells if _is_number(cell) or _has_comma(cell)]
        if len(cells) < 2 or 2 * len(numeric) <= len(cells):
            continue
        for above in (*texts, *reversed(comments)):
            if above < number and len(_cells(head[above])) == len(cells):
                return above
        break
    return texts[0] if texts else 0


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENT_MARKS)


def _cells(line: str) -> list[str]:
    """Return the cells of a line; a separator at its end begins none."""
    separator = _commonest_separator(line)
    if not separator:
        return line.lstrip(COMMENT_SIGNS).split()
    line = line.lstrip(COMMENT_SIGNS) if _is_comment(line) else line
    cells = next(lines.reader([line], delimiter=separator), [])
    return cells[:-1] if cells and not cells[-1].strip() else cells


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
    separator = _commonest_separator(first)
    if not separator:
        return (r"\s+" if len(first.split()) > 1 else ","), "."
    for line in head[1:21]:
        for cell in next(lines.reader([line], delimiter=separator), []):
            if _has_comma(cell):
                return separator, ","
    return separator, "."


def _commonest_separator(line: str) -> str:
    """Return the commonest separator of a line, or "" if it has none."""
    separator = max(SEPARATORS, key=line.count)
    return separator if separator in line else ""


def _has_comma(cell: str) -> bool:
    """Return whether a cell is a number with a decimal comma."""
    return "," in cell and _is_number(cell.replace(",", ".", 1))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
