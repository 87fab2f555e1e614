"""What a person sees on the terminal: progress while it runs, a summary at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from math import isfinite

from rich.console import Group
from rich.markup import escape
from rich.panel import Panel
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from stringcast.pipeline.run import Iteration, Result
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.common import Progress as Report

Bar = Callable[[str], AbstractContextManager[Report]]


@contextmanager
def bars(console: Terminal) -> Iterator[Bar]:
    """A bar for each step; one that reports no share pulses."""
    columns = (TextColumn("{task.description:<14}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:

        @contextmanager
        def bar(name: str) -> Iterator[Report]:
            task = progress.add_task(name, total=None)
            yield lambda share: progress.update(task, total=1.0, completed=share)
            progress.update(task, total=1.0, completed=1.0)

        yield bar


def summary(result: Result) -> Group:
    """How the run ended, manipulation by manipulation, or what a diagnosis or an alignment found."""
    if result.diagnosis is not None:
        return _found(result)
    if result.alignment is not None:
        return _measured(result)
    table = Table(box=None, pad_edge=False)
    for heading in ("cast", "tip in the box", "closest [mm]", "E before", "E after", "residual [mm]"):
        table.add_column(heading, justify="right")
    for iteration in result.iterations:
        table.add_row(*_row(iteration))
    words = "" if result.estimate is None else str(result.estimate.fit["sentence"].iloc[0])
    colour = "green" if result.hit else "yellow"
    ended, _, more = result.sentence.partition(". ")
    title = f"[bold {colour}]{escape(ended)}"
    below = [Text(more)] if more else []
    said = Panel(Group(table, "", Text(words), *below), title=title, border_style=colour)
    page = result.folder / "report.html"
    place = page if page.exists() else result.folder
    return Group(said, *map(Text, faults(result)), Text(str(place), overflow="fold"))


def _found(result: Result) -> Group:
    """The verdict, and what each cause is and does."""
    assert result.diagnosis is not None
    table = Table(box=None, pad_edge=False)
    for heading in ("cause", "probability", "parameter", "value", "95 % interval", "unit"):
        table.add_column(heading)
    for row in result.diagnosis.causes.itertuples():
        ends = f"at least {row.low:.4g}" if getattr(row, "at_least", False) else f"{row.low:.4g} to {row.high:.4g}"
        known = (f"{row.value:.4g}", ends) if row.parameter else ("", "")
        table.add_row(row.effect, f"{row.probability:.2f}", row.parameter, *known, row.unit)
    said = Panel(Group(Text(result.sentence), "", table), title=f"[bold]{result.diagnosis.verdict}")
    return Group(said, Text(f"{result.folder / 'report.html'}", overflow="fold"))


def _measured(result: Result) -> Group:
    """How camera and clock stand to the arm."""
    assert result.alignment is not None
    table = Table(box=None, pad_edge=False)
    for heading in ("parameter", "value", "95 % interval", "unit", ""):
        table.add_column(heading)
    for row in result.alignment.measured.itertuples():
        ends = f"{row.low:.5g} to {row.high:.5g}"
        table.add_row(row.name, f"{row.value:.5g}", ends, row.unit, "" if row.found else "not seen")
    said = Panel(Group(Text(result.sentence), "", table), title="[bold]camera and clock against the arm")
    return Group(said, Text(f"{result.folder / 'report.html'}", overflow="fold"))


def faults(result: Result) -> list[str]:
    """What went wrong, cast by cast: on the way to the arm, and with obstacles."""
    links = {i.number: i.done["execute"].link.iloc[0] for i in result.iterations if "execute" in i.done}
    late = {n: f"it is not to be trusted: {link['reason']}" for n, link in links.items() if not link["valid"]}
    touched = {i.number: i.verdict.touched for i in result.iterations if i.verdict is not None and i.verdict.touched}
    lay = {n: f"the string lay in an obstacle in {frames} frame(s)" for n, frames in touched.items()}
    return [f"Cast {number}: {words}." for fault in (late, lay) for number, words in fault.items()]


def _row(iteration: Iteration) -> list[str]:
    verdict, estimate = iteration.verdict, iteration.done.get("estimate")
    cells = [str(iteration.number)]
    if verdict is None or iteration.refused or not isfinite(verdict.distance):
        cells += ["", ""]
    else:
        cells += ["yes" if verdict.hit else "no", f"{verdict.distance * 1e3:.0f}"]
    if "predict" in iteration.done:
        return [*cells, "", "held out", f"{iteration.done['predict'].score['rms'].iloc[0] * 1e3:.1f}"]
    if estimate is None:
        return [*cells, "", "", ""]
    fit = estimate.fit.iloc[0]
    return [*cells, f"{fit['before']:.3f}", f"{fit['after']:.3f}", f"{fit['rms_after'] * 1e3:.1f}"]
