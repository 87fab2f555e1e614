"""What the page of the paper's experiments is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

LABELS = {
    "A_300_900": "A to (300, 900)",
    "A_400_700": "A to (400, 700)",
    "A_500_900": "A to (500, 900)",
    "B_300_900": "B to (300, 900)",
    "B_400_700": "B to (400, 700)",
    "B_500_900": "B to (500, 900)",
    "C_300_900": "C to (300, 900)",
    "C_400_700": "C to (400, 700)",
    "C_500_900": "C to (500, 900)",
    "nine": "all nine together",
    "A_900_500": "A to (900, 500)",
    "one_motion_A": "A, one first motion",
    "one_motion_B": "B, one first motion",
    "one_motion_C": "C, one first motion",
    "D_500_500": "D to (500, 500)",
    "wall": "A around the wall",
}  # every experiment, in the order in which they are shown, and those of three strings to three targets as one


@dataclass(frozen=True)
class Drawn:
    """A figure, and what it shows in words for those who cannot see it."""

    figure: Figure = field(repr=False)
    alt: str


@dataclass(frozen=True)
class PaperRecord:
    """tables: by name, see `pipeline.studies.paper`. asked: how many runs were asked for. settings: those that all runs
    have in common. origin: what made the page."""

    tables: Mapping[str, pd.DataFrame] = field(repr=False)
    asked: int
    settings: Mapping[str, Any] = field(repr=False)
    origin: Mapping[str, Any] = field(repr=False)

    def of(self, table: str, condition: str) -> pd.DataFrame:
        """The rows of a table that are of one experiment."""
        whole = self.tables[table]
        return whole[whole["condition"] == condition]

    def cast(self, table: str, condition: str, manipulation: int) -> pd.DataFrame:
        """The rows that are of one cast of the run that is shown."""
        mine = self.of(table, condition)
        return mine[mine["manipulation"] == manipulation]

    def casts(self, condition: str) -> list[int]:
        """Numbers of the casts of the run that is shown; none where no run is done."""
        return sorted(self.of("lines", condition)["manipulation"].unique().tolist())

    def verdict(self, condition: str, manipulation: int) -> pd.Series:
        """Row of table casts of one cast of the run that is shown."""
        seed = self.of("lines", condition)["seed"].iloc[0]
        mine = self.cast("casts", condition, manipulation)
        return mine[mine["seed"] == seed].iloc[0]

    @property
    def conditions(self) -> list[str]:
        """Experiments of which a run has ended, in their order."""
        return [name for name in LABELS if name in set(self.tables["rates"]["condition"])]
