"""Make a dataset from robot logs and tracker tables, and say what was understood."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from math import degrees, isnan
from os.path import commonprefix
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
from rich.table import Table

from stringcast.data.errors import ExpectedError
from stringcast.data.importers import SourceRecording
from stringcast.data.importers.files import read_recordings
from stringcast.data.importers.gather import ImportedTables, gather_tables
from stringcast.data.importers.reader import UsedColumn
from stringcast.data.schema import DataError
from stringcast.data.store import write_atomically
from stringcast.pipeline.cli.console import text_table
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import check
from stringcast.pipeline.commands.dataset_import import (
    ImportedDataset,
    convert_recordings,
    write_dataset,
)
from stringcast.pipeline.commands.import_geometry import Change, propose_geometry
from stringcast.pipeline.commands.import_options import (
    argument_parser,
    command_with,
    equivalent_command,
    expand_patterns,
    options_with,
    read_bench_hints,
    read_column_hints,
)
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.check.finding import Finding, error
from stringcast.stages.check.measured import CheckedDataset

# units of points, hand and angles, direction, clock and zero rows
MAX_CORRECTIONS = 8


class UnconfirmedChangeError(DataError):
    """A correction that a person must confirm, with the command that makes it."""

    def __init__(self, change: Change, command: str) -> None:
        super().__init__("it seems", change.reason, f"If that is so: {command}")
        self.change = change
        self.command = command


class NotUsableError(DataError):
    """Unusable data, with their overview."""

    def __init__(self, folder: Path, overview: dict[str, Any]) -> None:
        super().__init__(
            folder,
            "it was not written, because its data are not usable",
            "The findings above say what to do.",
        )
        self.overview = overview


def main(arguments: Sequence[str]) -> int:
    """Read, show and write the data; return 0 if a usable folder was written."""
    try:
        options = argument_parser(__doc__).parse_args(arguments)
    except UserError as wrong:
        return check.report_wrong_options(wrong, arguments)
    options.files = expand_patterns(options.files)
    console = Terminal(quiet=options.json)
    if not options.json:
        import_files(options, console)
        return 0
    try:
        overview = import_files(options, console)
    except NotUsableError as unusable:
        overview = unusable.overview
    except ExpectedError as refusal:
        finding = finding_of_refusal(options.files, refusal)
        overview = check.overview_of_unreadable(options.to, finding)
    print(json.dumps(overview, indent=2))
    return 0 if overview["usable"] else 1


def finding_of_refusal(files: Sequence[Path], refusal: ExpectedError) -> Finding:
    """Return the finding of refused files."""
    if isinstance(refusal, UnconfirmedChangeError):
        change = refusal.change
        return error(change.file, change.field, change.reason, refusal.command)
    finding = check.finding_of_error(refusal)
    known = {str(file) for file in files} | {file.name for file in files}
    if not finding.file or finding.file.split(", ")[0] in known:
        return finding
    statement = f"{finding.file}: {finding.statement}"
    return replace(finding, file="", statement=statement)


def import_files(options: argparse.Namespace, console: Terminal) -> dict[str, Any]:
    """Read, show and write the data; return their overview.

    Raises NotUsableError for unusable data, DataError for unreadable or ambiguous
    files, and UserError for a wrong option.
    """
    folder: Path = options.to
    if folder.exists():
        raise UserError(
            f"--to {folder}",
            "the folder exists already",
            f"Name another one, or remove it: rm -r {shlex.quote(str(folder))}",
        )
    recordings = read_recordings(options.files)
    options, tables, imported = interpret_recordings(recordings, options, console)
    checked = measure_dataset(imported)
    profile = None
    if imported.added_times and any(checked.with_points()):
        imported, checked, profile = fit_clocks(imported, checked)

    console.print(column_table(tables))
    for note in imported.notes:
        console.print(f"[yellow]note[/] {note}.", highlight=False, soft_wrap=True)
    picture = draw_first_trial(checked, folder, profile)
    overview = check.overview_with_clocks(checked) | {"folder": str(folder)}
    check.print_overview(overview, console)
    if picture is not None:
        console.print_line(f"What was understood, drawn: {picture}")
    command = equivalent_command(options)
    overview |= {"notes": list(imported.notes), "command": command}
    if not overview["usable"]:
        raise NotUsableError(folder, overview)
    with write_atomically(folder) as part:
        write_dataset(imported, part, options.files, command)
    diagnosis = f"+experiment=diagnose trials={shlex.quote(str(folder))}"
    console.print_line(f"Written: {folder}. The same again: {command}")
    console.print_line(f"Next: {program_name()} {diagnosis}")
    return overview


def interpret_recordings(
    recordings: Sequence[SourceRecording],
    options: argparse.Namespace,
    console: Terminal,
) -> tuple[argparse.Namespace, ImportedTables, ImportedDataset]:
    """Convert recordings, and correct impossible units, directions and clocks.

    Corrections are confirmed on a terminal and applied without a question elsewhere.
    Returns the options with them, the tables and the dataset.
    """
    for _ in range(MAX_CORRECTIONS):
        tables = gather_tables(recordings, read_column_hints(options))
        change = propose_degrees(tables) or propose_skipped_zeros(tables)
        bench = read_bench_hints(options)
        change = change or propose_geometry(tables, bench, options)
        if change is None:
            imported = convert_recordings(tables, bench)
            if not imported.trials_without_common_time:
                return options, tables, imported
            change = propose_clock_fit(imported, options)
        options = confirm_change(change, options, console)
    raise DataError(
        "",
        "The units and directions of these files stay unclear",
        "State them by the options that import --help lists.",
    )


def measure_dataset(imported: ImportedDataset) -> CheckedDataset:
    """Return the measurements of a dataset before it is written to its folder."""
    with TemporaryDirectory() as place:
        folder = Path(place) / "dataset"
        write_dataset(imported, folder, (), "")
        return check.read_measurements(folder, [])


def propose_degrees(tables: ImportedTables) -> Change | None:
    """Propose degrees if angles without a unit are too large for radians."""
    for column in tables.used_columns:
        if (column.unit, column.how) == ("deg", "values"):
            largest = degrees(max(-column.low, column.high))
            reason = (
                f"column '{column.column}' of {column.file.name} reaches "
                f"{largest:.0f}, which no joint does in radians"
            )
            return Change(reason, ["--deg"])
    return None


def propose_skipped_zeros(tables: ImportedTables) -> Change | None:
    """Propose to skip zero rows, if the hand's log has any."""
    if not tables.zero_rows:
        return None
    counts = [f"{count} in {file.name}" for file, count in tables.zero_rows.items()]
    reason = (
        f"single rows of the hand's log are exactly zero ({', '.join(counts)}), "
        "as if from a second publisher"
    )
    return Change(reason, ["--skip-zeros"])


def fit_clocks(
    imported: ImportedDataset, checked: CheckedDataset
) -> tuple[ImportedDataset, CheckedDataset, pd.DataFrame]:
    """Fit the clocks of a dataset with confirmed geometry.

    Returns the aligned dataset and measurements, and the profile of the offset.
    """
    # takes seconds to import
    from stringcast.pipeline.commands.clock_fit import apply_offset, estimate_offset

    clock = estimate_offset(checked)
    fitted = apply_offset(imported, clock)
    first = next(iter(clock.by_trial.values()))
    profile = clock.profile.assign(
        offset=clock.profile["offset"] - first.value,
        low=first.low - first.value,
        high=first.high - first.value,
    )
    return fitted, measure_dataset(fitted), profile


def propose_clock_fit(imported: ImportedDataset, options: argparse.Namespace) -> Change:
    """Propose to fit clocks of arm and camera without common time."""
    name = imported.trials_without_common_time[0]
    if options.clock is not None:
        raise DataError(
            f"--clock {options.clock}",
            f"arm and camera still have no time in common in trial {name}",
        )
    hand, points = imported.hand_rows, imported.points
    hand_t = hand.loc[hand["trial"] == name, "t"]
    point_t = points.loc[points["trial"] == name, "t"]
    reason = (
        f"arm and camera have no time in common: in trial {name} the arm's clock goes "
        f"from {hand_t.min():.2f} to {hand_t.max():.2f} s, the camera's from "
        f"{point_t.min():.2f} to {point_t.max():.2f} s"
    )
    return Change(reason, ["--clock", "fit"])


def confirm_change(
    change: Change, options: argparse.Namespace, console: Terminal
) -> argparse.Namespace:
    """Return the options with a change, after confirmation on a terminal.

    Raises DataError if it must be confirmed, but there is no terminal.
    """
    option = " ".join(change.words)
    can_ask = sys.stdin.isatty() and not (options.yes or options.json)
    if change.must_ask and not can_ask and not options.yes:
        command = command_with(options, change.words)
        raise UnconfirmedChangeError(change, command)
    console.print(
        f"[yellow]It seems:[/] {change.reason}.", highlight=False, soft_wrap=True
    )
    if can_ask:
        answer = input(f"Take it as {option}? [Y/n] ").strip().lower()
        if answer not in ("", "y", "yes"):
            raise UserError(
                "",
                "Nothing was written",
                "State units and directions: see import --help.",
            )
    else:
        taken = f"Taken as {option}."
        console.print(taken, highlight=False, markup=False, soft_wrap=True)
    return options_with(options, change.words)


def column_table(tables: ImportedTables) -> Table:
    """Return a table of used and unused columns.

    Files with the same columns share a row.
    """
    roles_of_file: dict[Path, set[str]] = {}
    for column in tables.used_columns:
        roles_of_file.setdefault(column.file, set()).add(column.role)
    used: dict[tuple[frozenset[str], str, str], list[UsedColumn]] = {}
    for column in tables.used_columns:
        unit = f" [{column.unit}]" if column.unit else ""
        meaning = f"{column.role}{unit}, by {column.how}"
        roles = frozenset(roles_of_file[column.file])
        used.setdefault((roles, column.column, meaning), []).append(column)
    rows = []
    for (_, name, meaning), columns in used.items():
        files = shared_file_name([column.file for column in columns])
        ends = ["", ""]
        if not isnan(columns[0].low):
            unit = range_unit(columns[0])
            low = min(column.low for column in columns)
            high = max(column.high for column in columns)
            ends = [f"{low:.4g}{unit}", f"{high:.4g}{unit}"]
        rows.append([files, name, meaning, *ends])

    unused: dict[str, list[Path]] = {}
    for file, names in tables.unused_columns.items():
        unused.setdefault(", ".join(map(str, names)), []).append(file)
    for listed_names, paths in unused.items():
        if listed_names:
            rows.append([shared_file_name(paths), listed_names, "left out", "", ""])
    headings = ["file", "column", "taken as", "from", "to"]
    return text_table(pd.DataFrame(rows, columns=headings), right=("from", "to"))


def range_unit(column: UsedColumn) -> str:
    """Return the unit of a column's range, after a blank; empty without one."""
    role = column.role
    if column.unit in ("1", "px") or role == "trial" or role.endswith("valid"):
        return ""
    if role == "t":
        return " s"
    return " rad" if role == "theta" or role.startswith("q") else " m"


def shared_file_name(files: Sequence[Path]) -> str:
    """Return the name of a file, or the common part of several names."""
    names = list(dict.fromkeys(file.name for file in files))
    if len(names) == 1:
        return names[0]
    beginning = commonprefix(names).rstrip("0123456789")  # noqa: RUF071 (of characters)
    return f"{beginning}* ({len(names)})"


def draw_first_trial(
    checked: CheckedDataset, folder: Path, profile: pd.DataFrame | None
) -> Path | None:
    """Draw the first trial with points to a file beside the folder; return its path.

    profile: of the clock offset, if it was fitted.
    """
    # takes a second to import
    from stringcast.stages.report.charts.trial import trial_figure

    trial = next(checked.with_points(), None)
    if trial is None:
        return None
    path = folder.with_name(f"{folder.name}.png")
    with write_atomically(path) as part:
        trial_figure(trial, profile).savefig(part, format="png", dpi=110)
    return path
