"""Tables with units: what a column is called, measured in, and means.

A `Table` is the schema of one Parquet file. `check` turns any data frame into one
that fits, or says which column is wrong; `arrow` is the same schema for pyarrow,
with unit and meaning in each field's metadata.
"""

from __future__ import annotations

from dataclasses import dataclass

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


class DataError(ExpectedError):
    """Data that cannot be used; the message names the field, the file and the remedy."""


@dataclass(frozen=True)
class Column:
    """One column: `unit` is SI or "1" (dimensionless) or "" (not a quantity)."""

    name: str
    unit: str
    meaning: str
    kind: str = "float"
    optional: bool = False

    def arrow_field(self) -> pa.Field:
        """The Arrow field, with unit and meaning as metadata."""
        metadata = {"unit": self.unit, "meaning": self.meaning}
        return pa.field(self.name, ARROW_TYPES[self.kind], metadata=metadata)


@dataclass(frozen=True)
class Table:
    """The schema of one Parquet file. Columns it does not know are kept and ignored."""

    name: str
    meaning: str
    columns: tuple[Column, ...]

    def arrow_schema(self, frame: pd.DataFrame) -> pa.Schema:
        """The Arrow schema for `frame`: known columns first, extra columns as they are."""
        known = [
            column.arrow_field() for column in self.columns if column.name in frame
        ]
        names = {field.name for field in known}
        extra = [name for name in frame.columns if name not in names]
        inferred = (
            pa.Schema.from_pandas(frame[extra], preserve_index=False) if extra else []
        )
        return pa.schema(
            [*known, *inferred], metadata={"table": self.name, "meaning": self.meaning}
        )

    def check(self, frame: pd.DataFrame, source: str = "memory") -> pd.DataFrame:
        """`frame` with the declared types and order; raises DataError naming the column
        and `source`.
        """
        missing = [
            c.name for c in self.columns if not c.optional and c.name not in frame
        ]
        if missing:
            raise DataError(
                f"{source}: table '{self.name}' has no column {', '.join(map(repr, missing))}; "
                f"it has {', '.join(map(str, frame.columns)) or 'none'}. Add the column or rename yours to it."
            )
        known = [c for c in self.columns if c.name in frame]
        extra = [name for name in frame.columns if name not in {c.name for c in known}]
        typed: dict[str, pd.Series] = {}
        for column in known:
            series = frame[column.name]
            try:
                if column.kind == "bool" and series.dtype != bool:
                    if any(isinstance(value, str) for value in series):
                        # else any text counts as true
                        raise ValueError("give true or false")
                    # what is missing is false
                    series = series.where(series.notna(), False)
                typed[column.name] = series.astype(PANDAS_TYPES[column.kind])
            except (ValueError, TypeError) as error:
                no_number = (
                    pd.to_numeric(series, errors="coerce").isna() & series.notna()
                )
                bad = series[no_number].iloc[0] if no_number.any() else series.iloc[0]
                raise DataError(
                    f"{source}: column '{column.name}' must be {column.kind} [{column.unit}]; "
                    f"found {bad!r} ({error}). Correct the value or remove the row."
                ) from error
        return pd.DataFrame(
            {**typed, **{name: frame[name] for name in extra}}
        ).reset_index(drop=True)

    def empty(self) -> pd.DataFrame:
        """A table of no rows."""
        return pd.DataFrame(
            {
                c.name: pd.Series(dtype=PANDAS_TYPES[c.kind])
                for c in self.columns
                if not c.optional
            }
        )
