"""Schemas of tables: name, unit and meaning of each column.

A `Table` is the schema of one Parquet file. `check` gives any data frame the
declared columns, or names the wrong one. `arrow_schema` is the schema for pyarrow, with
unit and meaning in each field's metadata.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import dedent
from typing import Any

import pandas as pd
import pyarrow as pa

from stringcast.data.errors import ExpectedError

ARROW_TYPES = {
    "float": pa.float64(),
    "int": pa.int64(),
    "bool": pa.bool_(),
    "text": pa.string(),
    "bytes": pa.binary(),
}
PANDAS_TYPES = {
    "float": "float64",
    "int": "int64",
    "bool": "bool",
    "text": "object",
    "bytes": "object",
}
UNSET: Any = None  # default of a part that may be missing, but must not be null


class DataError(ExpectedError):
    """Data that cannot be used; the message names field, file and remedy."""


@dataclass(frozen=True)
class Column:
    """The schema of a column.

    unit: SI, "1" (dimensionless) or "" (not a quantity). kind: a key of `ARROW_TYPES`.
    """

    name: str
    unit: str
    meaning: str
    kind: str = "float"
    optional: bool = False

    def arrow_field(self) -> pa.Field:
        """Make the Arrow field, with unit and meaning as metadata."""
        metadata = {"unit": self.unit, "meaning": self.meaning}
        return pa.field(self.name, ARROW_TYPES[self.kind], metadata=metadata)


COLUMN_LINE = re.compile(
    r"(?P<name>\w+)( \[(?P<unit>.+?)\])?( \((?P<traits>.+?)\))?: (?P<meaning>.+)"
)


def parse_columns(text: str) -> tuple[Column, ...]:
    """Parse the columns of a schema, one a line.

    A line is such as ``count [1] (int, optional): how many motions``. One that is
    indented farther continues the previous one. The default kind is float.
    """
    columns = []
    for line in re.sub(r"\n +", " ", dedent(text)).strip().splitlines():
        match = COLUMN_LINE.fullmatch(line)
        assert match is not None, f"no column: {line}"
        kind, _, optional = (match["traits"] or "float").partition(", ")
        if kind == "optional":
            kind, optional = "float", kind
        unit, meaning = match["unit"] or "", match["meaning"]
        columns.append(Column(match["name"], unit, meaning, kind, bool(optional)))
    return tuple(columns)


@dataclass(frozen=True)
class Table:
    """The schema of one Parquet file. Unknown columns are kept and ignored."""

    name: str
    meaning: str
    columns: tuple[Column, ...]

    def arrow_schema(self, frame: pd.DataFrame) -> pa.Schema:
        """Make the Arrow schema of a checked frame, known columns first."""
        fields = [
            column.arrow_field() for column in self.columns if column.name in frame
        ]
        extra = frame.columns[len(fields) :]
        if len(extra):
            fields += pa.Schema.from_pandas(frame[extra], preserve_index=False)
        return pa.schema(fields, metadata={"table": self.name, "meaning": self.meaning})

    def check(self, frame: pd.DataFrame, source: str = "memory") -> pd.DataFrame:
        """Give a frame the declared types and order of columns; unknown ones come last.

        `source` names the frame in messages. Raises DataError if a column is missing or
        a value has the wrong type.
        """
        missing = []
        typed = {}
        for column in self.columns:
            if column.name in frame:
                typed[column.name] = _cast(column, frame[column.name], source)
            elif not column.optional:
                missing.append(column.name)
        if missing:
            names = ", ".join(map(str, frame.columns)) or "none"
            raise DataError(
                source,
                f"table '{self.name}' has no column "
                f"{', '.join(map(repr, missing))}; it has {names}",
                "Add the column or rename yours to it.",
                field=", ".join(missing),
            )
        for name in frame.columns:
            if name not in typed:
                typed[name] = frame[name]
        return pd.DataFrame(typed).reset_index(drop=True)

    def from_rows(self, rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
        """Make a checked frame of rows, possibly without any."""
        return self.check(pd.DataFrame(rows)) if rows else self.empty()

    def empty(self) -> pd.DataFrame:
        """Make a frame without rows."""
        columns = {}
        for column in self.columns:
            if not column.optional:
                columns[column.name] = pd.Series(dtype=PANDAS_TYPES[column.kind])
        return pd.DataFrame(columns)


def tables_by_name(*tables: Table) -> dict[str, Table]:
    """Return the schemas of an artifact's tables by name."""
    return {table.name: table for table in tables}


def _cast(column: Column, values: pd.Series, source: str) -> pd.Series:
    """Cast values to the type of a column; raise DataError naming a wrong one."""
    dtype = PANDAS_TYPES[column.kind]
    if values.dtype == dtype:  # a cast takes 200 times as long
        return values
    try:
        if column.kind == "bool" and values.dtype != bool:
            if any(isinstance(value, str) for value in values):
                raise ValueError("give true or false")  # not any text as true
            values = values.where(values.notna(), False)  # a missing value is false
        return values.astype(dtype)
    except (ValueError, TypeError) as error:
        is_text = pd.to_numeric(values, errors="coerce").isna() & values.notna()
        wrong = values[is_text].iloc[0] if is_text.any() else values.iloc[0]
        raise DataError(
            source,
            f"column '{column.name}' must be {column.kind} [{column.unit}]; "
            f"found {wrong!r} ({error})",
            "Correct the value or remove the row.",
            field=column.name,
        ) from error
