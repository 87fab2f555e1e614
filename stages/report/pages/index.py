"""The page of all runs in a folder: how each ended, with a link to its own page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.report.formatting import rate
from stringcast.stages.report.page import (
    Card,
    Cell,
    Details,
    Page,
    Part,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    link,
    number,
)

# the first two find room on a phone
COLUMNS = ("ended as", "run", "casts or trials", "best E", "time [s]", "said")


def index_page(runs: pd.DataFrame, folder: str, origin: Mapping[str, Any]) -> str:
    """The page as text. runs: table RUNS of `pipeline.commands.index`, with `page`, the
    link to the run's own page, or empty. folder: that was listed.
    """
    newest = runs.sort_values("date", ascending=False, kind="stable")
    kinds = [
        Tile(str(count), str(kind))
        for kind, count in runs["state"].value_counts().items()
    ]
    rows = []
    for row in newest.to_dict("records"):
        best = rate(row["best_E"]) if np.isfinite(row["best_E"]) else ""
        numbers = [
            number(row["iterations"]),
            number(best),
            number(f"{row['seconds']:.0f}"),
        ]
        rows.append(
            [
                row["outcome"] or row["state"],
                Cell(_run(row), "name"),
                *numbers,
                row["said"],
            ]
        )
    sections: list[Part] = [
        Tiles(kinds),
        Section("Newest first", [Card("", [Table(COLUMNS, rows)])]),
    ]
    stale = newest[newest["stale"] != ""]
    if len(stale):
        lead = "A step of these would be made otherwise by the code and settings as they are now."
        why = Table(
            ("run", "why"),
            [(_run(row), row["stale"]) for row in stale.to_dict("records")],
        )
        sections.append(
            Section(
                "Stale", [Text(lead), Details(f"{len(stale)} of {len(runs)}", [why])]
            )
        )
    title = f"{len(runs)} run{'s' * (len(runs) != 1)} in {folder}"
    return str(
        Page(
            title,
            "stringcast runs",
            title,
            "Each links to its own page.",
            sections,
            origin,
            {},
        )
    )


def _run(row: Mapping[str, Any]) -> Any:
    return link(row["page"], row["run"]) if row["page"] else row["run"]
