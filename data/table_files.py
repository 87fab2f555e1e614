"""Finding the table files of a dataset, and reading their usable rows."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from stringcast.data.artifacts import ARM, FRAMES, GRASP, MASKS, POINTS, READINGS
from stringcast.data.errors import escape_control_characters
from stringcast.data.file_checks import is_file_inside, is_outside, require_inside
from stringcast.data.metadata import DATASET_FILE
from stringcast.data.rows import RowCounts, clean_rows, read_csv_table
from stringcast.data.schema import Column, DataError, Table
from stringcast.data.store import DIGEST_COLUMN, read_table

TRIAL_COLUMN = Column("trial", "", "name of the trial", "text")
RUN_TABLES = (ARM, FRAMES, POINTS, READINGS, MASKS)  # tables of our own runs
MAX_TRIALS = 4000  # each takes seconds to simulate once
ENDINGS = (".parquet", ".csv")


def with_trial(table: Table) -> Table:
    """Add the leading column `trial` to a table's schema."""
    return Table(table.name, table.meaning, (TRIAL_COLUMN, *table.columns))


def find_table(folder: Path, name: str) -> Path | None:
    """Find the file of a table, if there is one.

    Raises DataError if it is a link to somewhere else.
    """
    for ending in ENDINGS:
        path = folder / f"{name}{ending}"
        if path.exists():
            return require_inside(folder, path)
    return None


class TableRows(NamedTuple):
    """The usable rows of one table, in the order of time.

    counts: of all rows of its file, by the file's name; empty if none are dropped.
    """

    frame: pd.DataFrame
    counts: Mapping[str, RowCounts] = {}


def read_rows(table: Table, folder: Path) -> TableRows:
    """Read the usable rows of one table; raise DataError if it is missing."""
    path = find_table(folder, table.name)
    if path is None:
        alternative = {
            POINTS: ", nor frames or videos",
            GRASP: ", nor arm.parquet or arm.csv",
        }.get(table, "")
        raise DataError(
            folder,
            f"neither {table.name}.parquet nor {table.name}.csv{alternative}",
            _missing_table_remedy(folder),
        )
    schema = with_trial(table)
    read = read_csv_table if path.suffix == ".csv" else read_table
    frame = read(schema, path)
    _refuse_odd_trials(frame["trial"].unique(), path)
    if table in (READINGS, MASKS):  # their NaN are valid
        frame = frame.sort_values(["trial", "t"], kind="stable")
        return TableRows(frame.reset_index(drop=True))
    if table is FRAMES:
        frame = frame.assign(file=_frame_files(frame["file"], folder, path))
        if DIGEST_COLUMN in frame:  # trials whose frames were not kept have no film
            count = frame.groupby("trial")["file"].transform("count")
            is_kept = (count > 0) | frame[DIGEST_COLUMN].isna()
            frame = frame[is_kept]
            if len(is_kept) and frame.empty:
                return TableRows(frame)
    frame, counts = clean_rows(schema, frame)
    return TableRows(frame.reset_index(drop=True), {path.name: counts})


def _refuse_odd_trials(names: Sequence[str], path: Path) -> None:
    """Refuse too many trials, and names with control characters."""
    if len(names) > MAX_TRIALS:
        raise DataError(
            path,
            f"it holds {len(names)} trials, at most {MAX_TRIALS} are read",
            "Split it.",
        )
    for name in names:
        if not str(name).isprintable():
            raise DataError(
                path,
                f"the trial {str(name)!r} has a name that cannot be printed",
                "Give it another.",
            )


def _frame_files(files: pd.Series, folder: Path, path: Path) -> pd.Series:
    """Replace missing image files by NaN, and refuse files outside the folder."""
    exists = files.map(lambda file: is_file_inside(folder, str(file))).astype(bool)
    for file in files[~exists].dropna():
        if is_outside(folder, str(file)):
            raise DataError(
                path,
                f"the frame '{escape_control_characters(str(file))}' (column "
                f"file) lies outside the folder {folder}",
                "Copy it there, and name it by its path in the folder.",
            )
    return files.where(exists)


def _missing_table_remedy(folder: Path) -> str:
    """Describe the remedy for a missing table, which may have another name."""
    # runs are in outputs/<date>/<time>-<name>; the newest is last
    runs = sorted(folder.glob(f"*/*/{DATASET_FILE}"))
    inner = [*sorted(folder.glob(f"*/{DATASET_FILE}")), *reversed(runs)]
    if inner:
        return f"A dataset lies in {inner[0].parent}. Name that folder."
    own_names = {table.name for table in (GRASP, *RUN_TABLES)}
    files = []
    for path in sorted(folder.iterdir()):
        is_table = path.suffix in (*ENDINGS, ".tsv", ".h5", ".mcap")
        is_own = path.suffix in ENDINGS and path.stem in own_names
        if is_table and not is_own:
            files.append(shlex.quote(str(path)))
    if not files:
        return "Add it, with column 'trial'."
    if len(files) > 4:
        files[4:] = ["..."]
    target = shlex.quote(f"{folder}-imported")
    return (
        "If other files hold it: python -m pipeline import "
        f"{' '.join(files)} --to {target}"
    )
