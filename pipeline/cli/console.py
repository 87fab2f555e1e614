"""Progress bars during a run, and a summary at its end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from math import isfinite

import pandas as pd
from rich.console import Group, JustifyMethod, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from stringcast.data.estimates import Estimate, Prediction
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.iterations import Iteration
from stringcast.pipeline.run.log import ForwardingHandler, attach_handler
from stringcast.pipeline.run.result import RunResult
from stringcast.stages.common import Progress as ReportProgress

ProgressBar = Callable[[str], AbstractContextManager[ReportProgress]]
MAX_TITLE_CHARACTERS = 74  # fits into a panel of 80 columns
MAX_LOG_CHARACTERS = 36  # fits beside a bar in 80 columns
CAST_COLUMNS = (
    "tip in the box",
    "closest [mm]",
    "E before",
    "E after",
    "rms [mm]",
)


@contextmanager
def progress_bars(console: Terminal) -> Iterator[ProgressBar]:
    """Show a bar for each step, followed by the last line of the log.

    Yields a function that creates the bar of a named step. A bar pulses until progress
    is reported.
    """
    name_column = TextColumn("{task.description:<14}", markup=False)
    log_column = TextColumn("{task.fields[log_line]}", markup=False)
    with Progress(
        name_column, BarColumn(18), TimeElapsedColumn(), log_column, console=console
    ) as progress:

        @contextmanager
        def show_bar(name: str) -> Iterator[ReportProgress]:
            task = progress.add_task(name, total=None, log_line="")

            def show_log_line(line: str) -> None:
                progress.update(task, log_line=line[:MAX_LOG_CHARACTERS])

            def show_share(share: float) -> None:
                progress.update(task, total=1.0, completed=share)

            with attach_handler(ForwardingHandler(show_log_line)):
                yield show_share
            progress.update(task, total=1.0, completed=1.0, log_line="")

        yield show_bar


@contextmanager
def progress_bar(
    name: str, console: Terminal | None = None
) -> Iterator[ReportProgress]:
    """Show a single bar, by default on the standard error stream."""
    with progress_bars(console or Terminal(stderr=True)) as bar, bar(name) as progress:
        yield progress


def print_summary(result: RunResult, console: Terminal) -> None:
    """Print the outcome of a run, faults of its casts, and the path of its page."""
    if result.stage is None:
        console.print(cast_panel(result))
    else:
        summary = result.stage.summary(result.final_artifact)
        parts: list[RenderableType] = [Text(result.sentence)]
        if len(summary.table):
            parts += ["", text_table(summary.table)]
        console.print(Panel(Group(*parts), title=f"[bold]{escape(summary.title)}"))

    for iteration in result.iterations:
        if iteration.refusal_reason:
            console.print_line(
                f"{iteration.title.capitalize()}: the trial is invalid: "
                f"{iteration.refusal_reason}."
            )
    for iteration in result.iterations:
        frames = iteration.verdict.touched if iteration.verdict is not None else 0
        if frames:
            console.print_line(
                f"Cast {iteration.number}: the string touched an obstacle "
                f"in {frames} frame(s)."
            )

    page = result.folder / "report.html"
    console.print_line(str(page if page.exists() else result.folder))


def cast_panel(result: RunResult) -> Panel:
    """Return a panel with a row per cast, and the determined parameters."""
    outcome, _, details = result.sentence.partition(". ")
    fits_title = len(outcome) <= MAX_TITLE_CHARACTERS
    colour = "green" if result.has_hit else "yellow"

    parts: list[RenderableType] = [] if fits_title else [Text(outcome, "bold"), ""]
    rows = [row for row in map(cast_row, result.iterations) if any(row[1:])]
    if rows:
        has_casts = any(iteration.verdict for iteration in result.iterations)
        parts.append(cast_table(rows, "cast" if has_casts else "trial"))
    if result.last_estimate is not None:
        parts += ["", Text(str(result.last_estimate.fit["sentence"].iloc[0]))]
        intervals = determined_parameters(result.last_estimate)
        if len(intervals):
            parts += ["", text_table(intervals)]
    if details:
        parts += ["", Text(details)]
    title = f"[bold {colour}]{escape(outcome)}" if fits_title else None
    return Panel(Group(*parts), title=title, border_style=colour)


def cast_table(rows: list[list[str]], heading: str) -> Table:
    """Return a table of casts or stored trials without its empty columns."""
    frame = pd.DataFrame(rows, columns=[heading, *CAST_COLUMNS])
    return text_table(frame.loc[:, (frame != "").any()], right=frame.columns)


def cast_row(iteration: Iteration) -> list[str]:
    """Return the cells of a cast or stored trial, some of them empty."""
    verdict, estimate = iteration.verdict, iteration.find(Estimate)
    name = "look" if iteration.is_look else str(iteration.number)
    cells = [name, "", ""]
    if (
        verdict is not None
        and not iteration.refusal_reason
        and isfinite(verdict.distance)
    ):
        cells[1:] = ["yes" if verdict.hit else "no", f"{verdict.distance * 1e3:.0f}"]
    if (prediction := iteration.find(Prediction)) is not None:
        rms = prediction.score["rms"].iloc[0]
        return [*cells, "", "held out", f"{rms * 1e3:.1f}"]
    if estimate is None:
        return [*cells, "", "", ""]
    fit = estimate.fit.iloc[0]
    return [
        *cells,
        f"{fit['before']:.3f}",
        f"{fit['after']:.3f}",
        f"{fit['rms_after'] * 1e3:.1f}",
    ]


def determined_parameters(estimate: Estimate) -> pd.DataFrame:
    """Return a table of texts for parameters with a 95 % interval."""
    rows = estimate.parameters
    rows = rows[rows["determined"] & rows["low"].notna()]
    if rows.empty:
        return rows
    numbers = rows[["value", "low", "high"]].map("{:.4g}".format)
    columns = {
        "parameter": rows["name"],
        "value": numbers["value"],
        "95 % interval": numbers["low"] + " to " + numbers["high"],
        "unit": rows["unit"],
    }
    return pd.DataFrame(columns)


def text_table(frame: pd.DataFrame, right: Collection[str] = ()) -> Table:
    """Return a table of texts for the terminal.

    right: columns that are aligned to the right, such as numbers.
    """
    table = Table(box=None, pad_edge=False)
    for heading in frame.columns:
        justify: JustifyMethod = "right" if heading in right else "left"
        table.add_column(escape(heading), justify=justify, overflow="fold")
    for row in frame.itertuples(index=False):
        table.add_row(*(Text(str(cell)) for cell in row))
    return table
