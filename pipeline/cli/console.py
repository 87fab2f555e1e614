"""The terminal: progress while a run goes on, a summary at its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from math import isfinite

import pandas as pd
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.iterations import Iteration
from stringcast.pipeline.run.log import forward_log
from stringcast.pipeline.run.result import RunResult
from stringcast.stages.common import Progress as Report

ProgressBar = Callable[[str], AbstractContextManager[Report]]
# characters of a panel's title in 80 columns; a longer one would be cut
MAX_TITLE_CHARACTERS = 74
# characters of a log line that find room behind a bar, of 80 columns
MAX_LOG_CHARACTERS = 36


@contextmanager
def progress_bars(console: Terminal) -> Iterator[ProgressBar]:
    """A bar for each step, with the last line of the log behind it; one that reports no
    share pulses.
    """
    name_of, doing = (
        TextColumn(text, markup=False)
        for text in ("{task.description:<14}", "{task.fields[doing]}")
    )
    with Progress(
        name_of, BarColumn(18), TimeElapsedColumn(), doing, console=console
    ) as progress:

        @contextmanager
        def bar(name: str) -> Iterator[Report]:
            task = progress.add_task(name, total=None, doing="")
            with forward_log(
                lambda line: progress.update(task, doing=line[:MAX_LOG_CHARACTERS])
            ):
                yield lambda share: progress.update(task, total=1.0, completed=share)
            progress.update(task, total=1.0, completed=1.0, doing="")

        yield bar


def print_summary(result: RunResult, console: Terminal) -> None:
    """A summary of the run, what was at fault, and where its page is: a path on one
    line, to be pasted.
    """
    if result.stage is None:
        console.print(cast_panel(result))
    else:
        summary = result.stage.summary(result.final_artifact)
        title = f"[bold]{escape(summary.title)}"
        console.print(
            Panel(
                Group(Text(result.sentence), "", text_table(summary.table)), title=title
            )
        )
    # faults cast by cast: on the way to the arm, and with obstacles
    links = {
        i.number: i.artifacts["trial"].link.iloc[0]
        for i in result.iterations
        if "trial" in i.artifacts
    }
    late = {
        n: f"it is not to be trusted: {link['reason']}"
        for n, link in links.items()
        if not link["valid"]
    }
    touched = {
        i.number: i.verdict.touched
        for i in result.iterations
        if i.verdict is not None and i.verdict.touched
    }
    lay = {
        n: f"the string lay in an obstacle in {frames} frame(s)"
        for n, frames in touched.items()
    }
    for number, words in (*late.items(), *lay.items()):
        console.print(f"Cast {number}: {words}.", markup=False, highlight=False)
    report = result.folder / "report.html"
    place = report if report.exists() else result.folder
    console.print(str(place), soft_wrap=True, markup=False, highlight=False)


def cast_panel(result: RunResult) -> Panel:
    """Manipulation by manipulation, and what they taught."""
    colour = "green" if result.has_hit else "yellow"
    ended, _, more = result.sentence.partition(". ")
    parts: list[RenderableType] = (
        [] if len(ended) <= MAX_TITLE_CHARACTERS else [Text(ended, "bold"), ""]
    )
    # a row for each cast or stored trial of which there is anything to say, without
    # columns in which there is not
    headings = (
        "cast",
        "tip in the box",
        "closest [mm]",
        "E before [1]",
        "E after [1]",
        "rms [mm]",
    )
    rows = [row for row in map(cast_row, result.iterations) if any(row[1:])]
    kept = [n for n in range(len(headings)) if n == 0 or any(row[n] for row in rows)]
    table = Table(box=None, pad_edge=False)
    for n in kept:
        table.add_column(Text(headings[n]), justify="right")
    for row in rows:
        table.add_row(*(row[n] for n in kept))
    parts += [table] if rows else []
    if result.last_estimate is not None:
        parts += ["", Text(str(result.last_estimate.fit["sentence"].iloc[0]))]
        # the parameters that the casts determine, with their intervals
        known = result.last_estimate.parameters
        known = known[known["determined"] & known["low"].notna()]
        if len(known):
            ends = known[["low", "high"]].map("{:.4g}".format).agg(" to ".join, axis=1)
            values = {
                "parameter": known["name"],
                "value": known["value"].map("{:.4g}".format),
            }
            parts += [
                "",
                text_table(
                    pd.DataFrame(
                        {**values, "95 % interval": ends, "unit": known["unit"]}
                    )
                ),
            ]
    if more:
        parts += ["", Text(more)]
    title = (
        f"[bold {colour}]{escape(ended)}"
        if len(ended) <= MAX_TITLE_CHARACTERS
        else None
    )
    return Panel(Group(*parts), title=title, border_style=colour)


def text_table(frame: pd.DataFrame) -> Table:
    """A table for the terminal, of texts."""
    table = Table(box=None, pad_edge=False)
    for heading in frame.columns:
        table.add_column(escape(heading), overflow="fold")
    for row in frame.itertuples(index=False):
        table.add_row(*(Text(str(cell)) for cell in row))
    return table


def cast_row(iteration: Iteration) -> list[str]:
    verdict, estimate = iteration.verdict, iteration.artifacts.get("estimate")
    cells = [str(iteration.number)]
    if verdict is None or iteration.refusal_reason or not isfinite(verdict.distance):
        cells += ["", ""]
    else:
        cells += ["yes" if verdict.hit else "no", f"{verdict.distance * 1e3:.0f}"]
    if "prediction" in iteration.artifacts:
        return [
            *cells,
            "",
            "held out",
            f"{iteration.artifacts['prediction'].score['rms'].iloc[0] * 1e3:.1f}",
        ]
    if estimate is None:
        return [*cells, "", "", ""]
    fit = estimate.fit.iloc[0]
    return [
        *cells,
        f"{fit['before']:.3f}",
        f"{fit['after']:.3f}",
        f"{fit['rms_after'] * 1e3:.1f}",
    ]
