"""The numbers that the paper prints, from one file, each with its place there."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from stringcast.data.schema import Column, Table

FILE = Path(__file__).with_name("numbers.csv")
NUMBERS = Table(
    "numbers",
    "numbers that the paper prints; units as printed, with Nm written N m",
    (
        Column("what", "", "minimum and maximum of Table 3, a column of Table 4, hit_at, or a setting", "text"),
        Column("of", "", "parameter, string, or experiment", "text"),
        Column("value", "", "as printed, in SI"),
        Column("unit", "", "as printed", "text"),
        Column("place", "", "in the paper", "text"),
    ),
)


def numbers() -> pd.DataFrame:
    """Table NUMBERS."""
    return NUMBERS.check(pd.read_csv(FILE), str(FILE))


def of(what: str) -> dict[str, float]:
    """Values of one kind, by what they are of."""
    table = numbers()
    some = table[table["what"] == what]
    return dict(zip(some["of"], some["value"], strict=True))
