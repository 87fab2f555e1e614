"""The page of all runs in a folder: how each ended, with a link to its own page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.report.formatting import format_count, format_rate
from stringcast.stages.report.page import Page
from stringcast.stages.report.parts import (
    Cell,
    Details,
    Part,
    RunsView,
    Section,
    TableView,
    Text,
    Tiles,
    link,
    number_cells,
)

# the first two fit on a phone
COLUMNS = (
    *("outcome", "run", "causes", "casts or trials", "best E", "time [s]"),
    *("start", "result"),
)

HOW_TO_SORT = (
    "Click on a heading to sort. The filter keeps runs that contain all words, such as "
    "missed, hit or a cause; a word such as E>0.9 compares a number."
)


def index_page(
    runs: pd.DataFrame,
    folder: str,
    origin: Mapping[str, Any],
    casts: Mapping[str, Mapping[str, Sequence[float | None]]],
) -> str:
    """Render the page of all runs in a folder.

    runs: table RUNS of `pipeline.commands.index`, with the link `page` to the run's own
    page, or an empty text. origin: code and packages. casts: closest approach `miss_mm`
    and matching rate `E` of each cast, by run.
    """
    newest = runs.sort_values("date", ascending=False, kind="stable").to_dict("records")
    states = [
        (str(count), str(state))
        for state, count in runs["state"].value_counts().items()
    ]
    rows = [_row(run) for run in newest]
    view = TableView(COLUMNS, rows)
    sections: list[Part] = [
        Tiles(states),
        Section("Newest first", [Text(HOW_TO_SORT), RunsView(view, casts)]),
    ]
    stale = [(_run_link(run), run["stale"]) for run in newest if run["stale"]]
    if stale:
        lead = (
            "With the current code and settings, a step of these runs could give "
            "another result."
        )
        table = Details(
            f"{len(stale)} of {len(runs)}", [TableView(("run", "reason"), stale)]
        )
        sections.append(Section("Stale", [Text(lead), table]))
    page = Page(
        kind="runs",
        name=folder,
        heading=f"{format_count(len(runs), 'run')} in {folder}",
        lead="Each run links to its own page.",
        sections=sections,
        origin=origin,
        settings={},
    )
    return str(page)


def _row(run: Mapping[str, Any]) -> list[Any]:
    best = format_rate(run["best_E"]) if np.isfinite(run["best_E"]) else ""
    numbers = number_cells([run["iterations"], best, f"{run['seconds']:.0f}"])
    outcome = run["outcome"] or run["state"]
    started = run["date"][:16].replace("T", " ")
    name = Cell(_run_link(run), "name")
    return [outcome, name, run["causes"], *numbers, started, run["message"]]


def _run_link(run: Mapping[str, Any]) -> Any:
    return link(run["page"], run["run"]) if run["page"] else run["run"]
