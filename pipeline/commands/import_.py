"""Make a dataset of logs and trackers' tables: say what was understood, draw it, write
the folder.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from math import isnan
from os.path import commonprefix
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table
from rich.text import Text

from stringcast.data.importers import SourceRecording
from stringcast.data.importers.columns import LENGTH_UNITS
from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import ImportedTables, gather_tables
from stringcast.data.importers.reader import UsedColumn
from stringcast.data.schema import DataError
from stringcast.data.store import write_atomically
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import check
from stringcast.pipeline.commands.dataset_import import (
    ImportedDataset,
    convert_recordings,
    write_dataset,
)
from stringcast.pipeline.commands.import_options import (
    argument_parser,
    equivalent_command,
    expand_patterns,
    read_bench_hints,
    read_column_hints,
)
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.check.mistakes import (
    Mistake,
    impossible_views,
    likeliest_mistakes,
)
from stringcast.stages.check.overview import dataset_overview

# as many things can be unclear one after another: units of points and hand, degrees,
# direction, clock
MAX_CORRECTIONS = 6


def main(arguments: Sequence[str]) -> int:
    """Read, show, write; 0 where a folder that can be used was written."""
    asked = argument_parser(__doc__).parse_args(arguments)
    asked.files = expand_patterns(asked.files)
    folder: Path = asked.to
    if folder.exists():
        raise UserError(
            f"--to {folder}: it is there already. Name another folder, or remove it: rm -r {folder}"
        )
    console, read = Terminal(), read_recordings(asked.files)
    what, made, measured = interpret_recordings(read, asked, console)
    console.print(column_table(what))
    for note in made.notes:
        console.print(f"[yellow]note[/] {note}.", highlight=False, soft_wrap=True)
    picture = draw_first_trial(measured, folder)
    found = dataset_overview(measured)
    check.print_overview(found | {"folder": str(folder)}, console)
    if picture is not None:
        console.print(
            f"What was understood, drawn: {picture}", soft_wrap=True, markup=False
        )
    if not found["usable"]:
        first = next(
            (f for f in found["findings"] if f["severity"] == Severity.ERROR), None
        )
        remedy = f" {first['remedy']}." if first else ""
        raise DataError(
            f"{folder}: it was not written, for nothing could be learnt from it as it is.{remedy}"
        )
    with write_atomically(folder) as aside:
        write_dataset(made, aside, asked.files, equivalent_command(asked))
    again = shlex.quote(str(folder))
    console.print(
        f"Written: {folder}. The same again: {equivalent_command(asked)}",
        soft_wrap=True,
        markup=False,
    )
    console.print(
        f"Next: {program_name()} +experiment=diagnose trials={again}",
        soft_wrap=True,
        markup=False,
    )
    return 0


def interpret_recordings(
    read: Sequence[SourceRecording], asked: argparse.Namespace, console: Terminal
) -> tuple[ImportedTables, ImportedDataset, CheckedDataset]:
    """The recordings with their interpretation. Where a wrong unit, direction or clock
    would explain why data cannot be right, that is asked on a terminal, and else
    assumed where no option says otherwise. `asked` is changed by it.
    """
    with TemporaryDirectory() as place:
        for number in range(MAX_CORRECTIONS):
            what = gather_tables(read, read_column_hints(asked))
            made = convert_recordings(what, read_bench_hints(asked))
            folder = Path(place) / str(number)
            change: Change | None
            if made.trials_without_common_time:
                change = propose_clock_fit(made, asked)
            else:
                write_dataset(made, folder, asked.files, "")
                measured = check.read_measurements(folder, [])
                contradictory = impossible_views(measured)
                likely = (
                    likeliest_mistakes(measured, contradictory) if contradictory else []
                )
                undoing = (
                    propose_correction(mistake, what, asked)
                    for mistake in (likely[0] if likely else ())
                )
                change = next(filter(None, undoing), None)
            if change is None:
                return what, made, measured
            confirm_change(*change, asked, console)
    raise DataError(
        "It stays unclear in which units and directions these files are. Say it: see import --help."
    )


# what seems so, the option that says it, and what it does
Change = tuple[str, str, Callable[[], object]]


def propose_clock_fit(made: ImportedDataset, asked: argparse.Namespace) -> Change:
    """Clocks that have nothing in common are laid over one another."""
    if asked.clock is not None:
        raise DataError(
            f"--clock {asked.clock}: trial {made.trials_without_common_time[0]} of arm and camera are still not of one time."
        )
    name = made.trials_without_common_time[0]
    hand, seen = (
        table.loc[table["trial"] == name, "t"]
        for table in (made.hand_rows, made.points)
    )
    why = (
        f"arm and camera have no time in common: in trial {name} the arm's clock goes from {hand.min():.2f} to "
        f"{hand.max():.2f} s, the camera's from {seen.min():.2f} to {seen.max():.2f} s"
    )
    return why, "--clock fit", lambda: setattr(asked, "clock", "fit")


def propose_correction(
    mistake: Mistake, what: ImportedTables, asked: argparse.Namespace
) -> Change | None:
    """The option that undoes a mistake, if there is one and the files do not say
    themselves what is so.
    """
    if mistake.option == "--deg":
        changes = asked.deg is None and any(
            one.unit == "rad" and one.how == "name" for one in what.used_columns
        )
        return (
            (mistake.statement, "--deg", lambda: setattr(asked, "deg", True))
            if changes
            else None
        )
    if mistake.option == "--y-down":
        return (
            None
            if asked.y_down or asked.plane
            else (mistake.statement, "--y-down", lambda: setattr(asked, "y_down", True))
        )
    if mistake.option:
        plane = mistake.option.partition("=")[2]
        return (
            None
            if asked.plane
            else (
                mistake.statement,
                mistake.option,
                lambda: setattr(asked, "plane", plane),
            )
        )
    if not mistake.parts or not {*mistake.parts} <= {"xy", "s", "hand", "length"}:
        return None
    # lengths of some files in another unit, where neither their columns nor a person
    # say in which
    unit = next(
        unit for unit, factor in LENGTH_UNITS.items() if factor == mistake.factor
    )
    hand, points = "hand" in mistake.parts, bool({"xy", "s"} & {*mistake.parts})
    wanted = {"x": hand, "y": hand, "s": points}  # by role; a point's are such as tip.x
    metres = (one for one in what.used_columns if one.unit == "m")
    files = {
        one.file.name
        for one in metres
        if wanted.get(one.role, points and one.role.endswith((".x", ".y")))
    }
    said = [f"{file}={unit}" for file in sorted(files)]
    if not files or any(text in asked.unit for text in said):
        return None
    return (
        mistake.statement,
        " ".join(f"--unit {text}" for text in said),
        lambda: asked.unit.extend(said),
    )


def confirm_change(
    why: str,
    option: str,
    change: Callable[[], object],
    asked: argparse.Namespace,
    console: Terminal,
) -> None:
    """Change what was asked for, after a yes where somebody can be asked."""
    console.print(f"[yellow]It seems:[/] {why}.", highlight=False, soft_wrap=True)
    if sys.stdin.isatty() and not asked.yes:
        if input(f"Take it as {option}? [Y/n] ").strip().lower() not in (
            "",
            "y",
            "yes",
        ):
            raise UserError("Nothing was written. Say what is so: see import --help.")
    else:
        console.print(f"Taken as {option}.", highlight=False, markup=False)
    change()


def column_table(what: ImportedTables) -> Table:
    """A table of the columns as they were read, and of those left out; files of the
    same columns as one.
    """
    table = Table(box=None, pad_edge=False)
    for heading in ("file", "column", "taken as", "from", "to"):
        table.add_column(
            Text(heading),
            justify="right" if heading in ("from", "to") else "left",
            overflow="fold",
        )
    alike: dict[tuple[str, ...], list[UsedColumn]] = {}
    for one in what.used_columns:
        unit = f" [{one.unit}]" if one.unit else ""
        alike.setdefault((one.column, f"{one.role}{unit}, by {one.how}"), []).append(
            one
        )
    for (column, role), those in alike.items():
        first = those[0]
        unit = {"t": " s", "theta": " rad", "trial": ""}.get(
            first.role, " rad" if first.role.startswith("q") else " m"
        )
        ours = "" if first.unit in ("1", "px") or first.role.endswith("valid") else unit
        ends = (
            []
            if isnan(those[0].low)
            else [min(one.low for one in those), max(one.high for one in those)]
        )
        cells = [
            shared_file_name([one.file for one in those]),
            column,
            role,
            *(f"{end:.4g}{ours}" for end in ends),
        ]
        table.add_row(*map(Text, cells))
    left = {
        tuple(map(str, names)): [
            f for f, n in what.unused_columns.items() if n == names
        ]
        for names in what.unused_columns.values()
    }
    for names, files in left.items():
        if names:
            table.add_row(
                *map(Text, (shared_file_name(files), ", ".join(names), "left out"))
            )
    return table


def shared_file_name(files: Sequence[Path]) -> str:
    """Names of files, several by what they have in common."""
    names = list(dict.fromkeys(file.name for file in files))
    begin = commonprefix(names)  # noqa: RUF071 (of characters)
    return (
        names[0] if len(names) == 1 else f"{begin.rstrip('0123456789')}* ({len(names)})"
    )


def draw_first_trial(measured: CheckedDataset, folder: Path) -> Path | None:
    """The path of a picture beside the folder, of the first trial of which points were
    measured.
    """
    from stringcast.stages.report.charts.trial import trial_figure  # noqa: PLC0415

    seen = next(measured.with_points(), None)
    if seen is None:
        return None
    path = folder.with_name(f"{folder.name}.png")
    with write_atomically(path) as aside:
        trial_figure(seen).savefig(aside, format="png", dpi=110)
    return path
