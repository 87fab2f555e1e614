"""List runs and how they ended; also as a page, or as one Parquet or CSV file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.progress import track
from rich.table import Table as TerminalTable
from rich.text import Text

from stringcast.data import store
from stringcast.data.errors import escape_control_characters
from stringcast.data.estimates import ESTIMATION_SUMMARY
from stringcast.data.file_checks import MAX_TEXT_BYTES, read_json, require_plain_file
from stringcast.data.schema import DataError, Table, parse_columns
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.run.file_names import FAILURE_FILE, artifact_tables
from stringcast.pipeline.run.provenance import software_versions, stale_reasons
from stringcast.pipeline.run.result import read_summary
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.named_plugins import UNNAMED_PLUGIN, stored_plugins
from stringcast.stages.entry_points import DRY_RUNS
from stringcast.stages.plugins import PluginError

RUNS_TABLE = Table(
    "runs",
    "a row for each run",
    parse_columns("""
    run (text): its folder, relative to the one that was listed
    experiment (text): its name
    date (text): when its first step began, UTC; empty before any
    state (text): ended, failed or incomplete
    outcome (text): hit, missed, dry run, estimated, or the verdict of a diagnosis;
        empty before the end
    causes (text): found by a diagnosis, separated by commas
    iterations [1] (int): casts, or trials used
    best_E [1]: best matching rate E of its estimates; NaN if there is none
    seconds [s]: duration of its steps
    stale (text): why a step of it is stale; empty if all are fresh
    not_kept (text): 'frames' if a step's frames were not kept, or empty
    message (text): outcome, or why the run stopped
    """),
)
# first characters of formulas in spreadsheets; the last four are East Asian forms
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\n", "＝", "＋", "－", "＠")
# fits into 80 columns
RUN_COLUMN_WIDTH, COLUMN_WIDTH = 38, 10


def main(arguments: list[str]) -> int:
    """List the runs of a folder; return 0, also without runs."""
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
    options = parser.parse_args(arguments)
    runs = list_runs(options.folder)
    if options.to is not None:
        write_runs(runs, options.to, options.folder)
    Terminal().print(printable_table(runs))
    return 0


def list_runs(folder: Path) -> pd.DataFrame:
    """Return table RUNS of all runs in a folder, however deep.

    Raises UserError if there is no such folder.
    """
    if not folder.is_dir():
        raise UserError(
            folder,
            "there is no such folder",
            "Name one that holds runs.",
        )
    runs: list[Path] = []
    for path in folder.rglob("config.json"):
        if path.is_file():
            with path.open(encoding="utf-8", errors="replace") as file:
                if '"mode"' in file.read(MAX_TEXT_BYTES):
                    runs.append(path.parent)
    console = Terminal(stderr=True)
    rows = []
    for run in track(sorted(runs), "index", console=console, transient=True):
        rows.append(run_row(run) | {"run": run.relative_to(folder).as_posix()})
    return RUNS_TABLE.from_rows(rows)


def write_runs(runs: pd.DataFrame, to: Path, folder: Path) -> None:
    """Write the list of a folder's runs as a page, Parquet or CSV, by its ending."""
    if to.suffix == ".csv":
        store.write_text(to, runs.map(neutralise_formula).to_csv(index=False))
    elif to.suffix == ".parquet":
        store.write_table(RUNS_TABLE, runs, to, {"step": "index"} | software_versions())
    elif to.suffix == ".html":
        # takes a second to import
        from stringcast.stages.report.pages.index import index_page

        links = []
        for run in runs["run"]:
            page = folder / run / "report.html"
            link = Path(os.path.relpath(page, to.parent)).as_posix()
            links.append(link if page.is_file() else "")
        origin = {"seed": "of each run"} | software_versions()
        casts = casts_of_runs(runs, folder)
        page = index_page(runs.assign(page=links), str(folder), origin, casts)
        store.write_text(to, page)
    else:
        raise UserError(
            f"--to {to}",
            "it must end in .html, .parquet or .csv",
            "Change it.",
        )


def casts_of_runs(
    runs: pd.DataFrame, folder: Path
) -> dict[str, dict[str, list[float | None]]]:
    """Return closest approach [mm] and matching rate E of each cast of ended runs."""
    casts = {}
    for name in runs.loc[runs["outcome"].isin(["hit", "missed"]), "run"]:
        rows = read_summary(folder / name)["iterations"]
        misses = [row.get("miss_m") for row in rows]
        casts[name] = {
            "miss_mm": [None if miss is None else 1e3 * miss for miss in misses],
            "E": [row.get("E_after") for row in rows],
        }
    return casts


def neutralise_formula(value: Any) -> Any:
    """Return a text that is harmless in spreadsheets and terminals.

    An apostrophe turns a formula into text.
    """
    if not isinstance(value, str):
        return value
    text = escape_control_characters(value)
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def run_row(run: Path) -> dict[str, Any]:
    """Return the row of a run; for a damaged run, it states the fault."""
    try:
        settings = read_json(run / "config.json")
        summary = read_summary(run)
        row = {
            "experiment": str(settings["name"]),
            **ending_columns(run, settings, summary),
            **step_columns(run, settings, summary),
        }
        for name, value in row.items():
            if isinstance(value, str):
                row[name] = escape_control_characters(value)
        return row
    except Exception as error:  # a foreign run may be damaged in any way
        reason = str(error) if isinstance(error, DataError) else repr(error)
        texts = [c.name for c in RUNS_TABLE.columns if c.kind == "text"]
        numbers = {"iterations": 0, "best_E": np.nan, "seconds": 0.0}
        said = {"state": "damaged", "message": reason}
        return dict.fromkeys(texts, "") | numbers | said


def printable_table(runs: pd.DataFrame) -> TerminalTable:
    """Return the list for the terminal: outcomes, or else states of runs."""
    table = TerminalTable(box=None, pad_edge=False)
    run_width = max(runs["run"].str.len(), default=0)
    table.add_column("run", overflow="fold", min_width=min(RUN_COLUMN_WIDTH, run_width))
    table.add_column("ended as", max_width=COLUMN_WIDTH)
    for heading in ("casts", "best E", "time [s]", "stale"):
        table.add_column(Text(heading), justify="right", max_width=COLUMN_WIDTH)
    lacks_outputs = bool(runs["not_kept"].any())
    if lacks_outputs:
        table.add_column("not kept", max_width=COLUMN_WIDTH)
    for run in runs.itertuples(index=False):
        cells = [
            run.run,
            run.outcome or run.state,
            str(run.iterations),
            "" if np.isnan(run.best_E) else f"{run.best_E:.3f}",
            f"{run.seconds:.0f}",
            stale_word(run.stale),
        ]
        if lacks_outputs:
            cells.append(run.not_kept)
        table.add_row(*map(Text, cells))
    return table


def ending_columns(
    run: Path, settings: Mapping[str, Any], summary: Mapping[str, Any]
) -> dict[str, str]:
    """Return state, outcome, causes and sentence of a run, with its run.json."""
    failure_file = run / FAILURE_FILE
    if not summary:
        reason = ""
        if failure_file.is_file():
            require_plain_file(failure_file, MAX_TEXT_BYTES)
            reason = failure_file.read_text(encoding="utf-8").strip()
        state = "failed" if reason else "incomplete"
        return {"state": state, "outcome": "", "causes": "", "message": reason}

    outcome, causes = "estimated", ""
    if (run / "diagnosis.json").is_file():
        diagnosis = read_json(run / "diagnosis.json")
        outcome = str(diagnosis["verdict"])
        causes = ", ".join(cause["effect"] for cause in diagnosis["causes"])
    elif any("hit" in iteration for iteration in summary["iterations"]):
        # a rehearsal does not cast at the target
        if settings["execute"]["_target_"] in DRY_RUNS:
            outcome = "dry run"
        else:
            outcome = "hit" if summary["hit"] else "missed"
    return {
        "state": "ended",
        "outcome": outcome,
        "causes": causes,
        "message": summary["sentence"],
    }


def step_columns(
    run: Path, settings: Mapping[str, Any], summary: Mapping[str, Any]
) -> dict[str, Any]:
    """Return date, time spent, best matching rate and staleness of a run's steps."""
    steps = sorted({file.parent for file in run.glob("iterations/*/*/*.parquet")})
    origins = [store.read_origin(step).get("made", {}) for step in steps]
    dates = [origin["at"] for origin in origins if origin]
    seconds = [origin.get("seconds", 0.0) for origin in origins]
    rates: list[float] = []
    for file in artifact_tables(run, "estimate", "fit"):
        estimation = store.read_table(ESTIMATION_SUMMARY, file)
        rates.append(float(estimation["after"].iloc[0]))

    count = len({step.parent for step in steps})
    if summary:  # a step may use several trials
        count = len(summary["iterations"])
    return {
        "date": min(dates, default=""),
        "iterations": count,
        "best_E": max(rates, default=np.nan),
        "seconds": float(sum(seconds)),
        "stale": first_stale_reason(run, steps, settings),
        "not_kept": "frames" if any(map(store.images_not_kept, steps)) else "",
    }


def stale_word(reason: str) -> str:
    """Return the reason why a run is stale in a word; empty for a fresh run."""
    if UNNAMED_PLUGIN in reason:
        return "plugin not named"
    return "yes" if reason else ""


def first_stale_reason(
    run: Path, steps: Sequence[Path], settings: Mapping[str, Any]
) -> str:
    """Return the first stale step of a run, and why it is; empty if all are fresh."""
    try:
        with stored_plugins(settings, "config.json"):
            for step in steps:
                if reasons := stale_reasons(run, step, settings):
                    return f"{step.relative_to(run).as_posix()}: {reasons[0]}"
    except (UserError, PluginError) as error:
        return str(error)
    return ""
