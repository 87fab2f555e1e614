"""List runs and how they ended, on the terminal, as a page, or as one Parquet or CSV
file.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.progress import track
from rich.table import Table as Printed
from rich.text import Text

from stringcast.data import store
from stringcast.data.artifacts import ESTIMATION_SUMMARY
from stringcast.data.file_checks import read_json
from stringcast.data.schema import Column, DataError, Table
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.run.file_names import FAILURE_FILE, SUMMARY_FILE
from stringcast.pipeline.run.provenance import software_versions, stale_reasons
from stringcast.pipeline.settings.allowed_callables import DRY_RUNS
from stringcast.pipeline.settings.composition import UserError

RUNS_TABLE = Table(
    "runs",
    "a row a run",
    (
        Column("run", "", "its folder, relative to the one that was listed", "text"),
        Column("experiment", "", "its name", "text"),
        Column("date", "", "when its first step began, UTC; empty before any", "text"),
        Column("state", "", "ended, failed or incomplete", "text"),
        Column(
            "outcome",
            "",
            "hit, missed, dry run, a diagnosis' verdict or estimated; empty before the end",
            "text",
        ),
        Column("iterations", "1", "casts, or trials looked at", "int"),
        Column(
            "best_E", "1", "best matching rate E of its estimates; NaN if there is none"
        ),
        Column("seconds", "s", "spent in its steps"),
        Column(
            "stale", "", "why a step of it is stale; empty if all are fresh", "text"
        ),
        Column("said", "", "how it ended or why it stopped, in words", "text"),
    ),
)
# what files of another make raise where they are read
READ_ERRORS = (KeyError, TypeError, ValueError, AttributeError)
# characters of a column, so that a row is one line of 80
RUN_COLUMN_WIDTH, COLUMN_WIDTH = 38, 10


def main(arguments: list[str]) -> int:
    """List the runs of a folder; the exit status, 0 also where there is none."""
    parser = CommandParser("python -m pipeline index", description=__doc__)
    parser.add_argument(
        "folder",
        type=Path,
        nargs="?",
        default=Path("outputs"),
        help="where runs are; default outputs",
    )
    parser.add_argument(
        "--to", type=Path, help="a .html, .parquet or .csv file to write the list to"
    )
    asked = parser.parse_args(arguments)
    runs = list_runs(asked.folder)
    if asked.to is not None:
        write_runs(runs, asked.to, asked.folder)
    Terminal().print(printable_table(runs))
    return 0


def list_runs(folder: Path) -> pd.DataFrame:
    """Table RUNS of all runs in a folder, however deep. Raises UserError where there is
    no such folder.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: there is no such folder. Name one that holds runs.")
    found: list[Path] = []
    for path in folder.rglob("config.json"):
        text = (
            path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
        )
        if '"mode"' in text:
            found.append(path.parent)
    shown = track(sorted(found), "index", console=Terminal(stderr=True), transient=True)
    rows = [{"run": run.relative_to(folder).as_posix()} | run_row(run) for run in shown]
    return RUNS_TABLE.check(pd.DataFrame(rows)) if rows else RUNS_TABLE.empty()


def write_runs(runs: pd.DataFrame, to: Path, folder: Path) -> None:
    """Write a table of runs as a page, Parquet or CSV, by the file's ending. folder:
    that was listed.
    """
    if to.suffix == ".csv":
        store.write_text(to, runs.to_csv(index=False))
    elif to.suffix == ".parquet":
        store.write_table(RUNS_TABLE, runs, to, {"step": "index"} | software_versions())
    elif to.suffix == ".html":
        # which takes a second to load
        index_page = import_module("stringcast.stages.report.pages.index").index_page
        own = [folder / run / "report.html" for run in runs["run"]]
        links = [
            Path(os.path.relpath(path, to.parent)).as_posix() if path.is_file() else ""
            for path in own
        ]
        store.write_text(
            to,
            index_page(
                runs.assign(page=links),
                str(folder),
                {"seed": "of each run"} | software_versions(),
            ),
        )
    else:
        raise UserError(
            f"--to {to}: it must end in .html, .parquet or .csv. Change it."
        )


def run_row(run: Path) -> dict[str, Any]:
    """One run. What is damaged does not stop the list: it says so."""
    try:
        settings, end = read_json(run / "config.json"), run / SUMMARY_FILE
        ended = read_json(end) if end.is_file() else {}
        return {
            "experiment": str(settings["name"]),
            **ending_columns(run, ended, settings),
            **step_columns(run, settings),
        }
    except (DataError, *READ_ERRORS) as error:
        nothing: dict[str, Any] = {
            "experiment": "",
            "outcome": "",
            "date": "",
            "iterations": 0,
            "best_E": float("nan"),
        }
        return nothing | {
            "seconds": 0.0,
            "state": "damaged",
            "stale": "",
            "said": str(error),
        }


def printable_table(runs: pd.DataFrame) -> Printed:
    """The list for people: how runs ended, or else in which state they are; `why` says
    more of what is stale.
    """
    table = Printed(box=None, pad_edge=False)
    table.add_column(
        "run",
        overflow="fold",
        min_width=min(RUN_COLUMN_WIDTH, max(runs["run"].str.len(), default=0)),
    )
    for heading in ("ended as", "casts", "best E", "time [s]", "stale"):
        table.add_column(
            Text(heading),
            justify="left" if heading == "ended as" else "right",
            max_width=COLUMN_WIDTH,
        )
    for one in runs.itertuples(index=False):
        best = "" if np.isnan(one.best_E) else f"{one.best_E:.3f}"
        cells = (
            one.run,
            one.outcome or one.state,
            str(one.iterations),
            best,
            f"{one.seconds:.0f}",
        )
        table.add_row(*map(Text, (*cells, "yes" if one.stale else "")))
    return table


def ending_columns(
    run: Path, ended: dict[str, Any], settings: Mapping[str, Any]
) -> dict[str, str]:
    """State, outcome and words. settings: the run's."""
    failed = run / FAILURE_FILE
    if not ended:
        said = failed.read_text(encoding="utf-8").strip() if failed.is_file() else ""
        return {
            "state": "failed" if said else "incomplete",
            "outcome": "",
            "said": said,
        }
    diagnosis, outcome = run / "diagnosis.json", "estimated"
    if diagnosis.is_file():
        outcome = read_json(diagnosis)["verdict"]
    elif any("hit" in iteration for iteration in ended["iterations"]):
        # without the arm, or with a slow one, nothing was thrown at the target at all
        dry = settings["execute"]["_target_"] in DRY_RUNS
        outcome = "dry run" if dry else "hit" if ended["hit"] else "missed"
    return {"state": "ended", "outcome": outcome, "said": ended["sentence"]}


def step_columns(run: Path, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The row's columns from a run's steps: when, how long, how good, and whether they
    are fresh.
    """
    steps = sorted({file.parent for file in run.glob("iterations/*/*/*.parquet")})
    made = [store.read_origin(step).get("made", {}) for step in steps]
    rates = [
        float(store.read_table(ESTIMATION_SUMMARY, fit)["after"].iloc[0])
        for fit in run.glob("iterations/*/estimate/fit.parquet")
    ]
    reasons = (
        (step.relative_to(run).as_posix(), stale_reasons(run, step, settings))
        for step in steps
    )
    return {
        "date": min((one["at"] for one in made if one), default=""),
        "iterations": len({step.parent for step in steps}),
        "best_E": max(rates, default=float("nan")),
        "seconds": float(sum(one.get("seconds", 0.0) for one in made)),
        "stale": next(
            (f"{place}: {words[0]}" for place, words in reasons if words), ""
        ),
    }
