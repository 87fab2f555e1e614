"""Say what is in a folder of measured data, and whether it can be trusted."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.markup import escape

from stringcast.data import dataset
from stringcast.data.errors import ExpectedError
from stringcast.data.store import write_text
from stringcast.pipeline.cli.console import text_table
from stringcast.pipeline.cli.terminal import Terminal, program_name, with_program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.composition import (
    UserError,
    compose_settings,
    given_names,
)
from stringcast.pipeline.settings.named_plugins import name_plugins
from stringcast.pipeline.settings.settings_from_runs import (
    inherit_settings,
    is_run_folder,
)
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.check.finding import Finding, error
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.check.overview import (
    DETECTION_NOTE,
    dataset_overview,
    effect_table,
    trial_table,
)
from stringcast.stages.clock.windows import HARMLESS_OFFSET_S, largest_possible_offset
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.report.formatting import format_count

USABLE, NOT_USABLE = 0, 1  # exit statuses
SEVERITY_COLOURS = {"error": "bold red", "warning": "yellow", "note": "dim"}


def main(arguments: Sequence[str]) -> int:
    """Print the content of a folder; return 0 if it is usable."""
    try:
        options = argument_parser().parse_intermixed_args(arguments)
        report: Path | None = options.report
        if report is not None and report.suffix != ".html":
            raise UserError(f"--report {report}", "it must end in .html", "Change it.")
    except UserError as wrong:
        return report_wrong_options(wrong, arguments)
    try:
        name_plugins(options.settings)
        checked = read_measurements(options.folder, options.settings)
        overview = overview_with_clocks(checked)
        if options.effects and overview["usable"]:
            # takes seconds to import
            from stringcast.pipeline.commands.check_effects import detectable_effects

            settings = settings_for_data(
                options.folder, options.settings, "+experiment=diagnose"
            )
            limits, not_tried = detectable_effects(settings)
            overview |= {"effects": limits, "effects_not_tried": not_tried}
        if report is not None:
            write_text(report, check_report(checked, overview))
    except (ExpectedError, HydraException, OmegaConfBaseException) as fault:
        finding = finding_of_error(fault)
        overview = overview_of_unreadable(options.folder, finding)

    if options.json:
        print(json.dumps(overview, indent=2))
    else:
        console = Terminal()
        print_overview(overview, console)
        if report is not None and report.exists():
            console.print_line(str(report))
    return USABLE if overview["usable"] else NOT_USABLE


def argument_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    parser = CommandParser(
        "python -m pipeline check", description=__doc__, allow_abbrev=False
    )
    add = parser.add_argument
    add("folder", type=Path, help="measured data, or a run's folder")
    add(
        "settings",
        nargs="*",
        default=[],
        help="as for a run, such as string.length=0.4 or arm=mine",
    )
    add(
        "--report",
        type=Path,
        help="a .html file to write: the same, with arm, string and clocks drawn",
    )
    add(
        "--effects",
        action="store_true",
        help="also say from which size on each effect would be found, in half a minute",
    )
    add("--json", action="store_true", help="print all that was found as JSON")
    return parser


def read_measurements(folder: Path, overrides: Sequence[str]) -> CheckedDataset:
    """Return the data in a folder, with arm, camera and string as in a run.

    overrides: settings as on the command line.
    """
    settings = settings_for_data(folder, overrides)
    arm = build_dataclass(Arm, settings["arm"], "arm", "conf/arm")
    camera = build_dataclass(Camera, settings["camera"], "camera", "conf/camera")
    length = float(settings["string"]["length"])
    return CheckedDataset(dataset.read_dataset(folder), arm, camera, length)


def overview_with_clocks(checked: CheckedDataset) -> dict[str, Any]:
    """Return the overview of a dataset, with an error for clocks with an offset.

    The string model is fitted only if the dataset does not state the offset, and if
    geometry allows a large one.
    """
    overview = dataset_overview(checked)
    trials = list(checked.informative_trials())
    states_clock = "clock" in checked.data.metadata
    if not overview["usable"] or states_clock or is_run_folder(checked.data.folder):
        return overview
    if largest_possible_offset(trials) < HARMLESS_OFFSET_S:
        return overview
    # takes seconds to import
    from stringcast.pipeline.commands.clock_fit import wrong_clock_findings

    findings = [asdict(found) for found in wrong_clock_findings(checked)]
    return overview | {
        "usable": not findings,
        "findings": [*findings, *overview["findings"]],
    }


def settings_for_data(
    folder: Path, overrides: Sequence[str], *defaults: str
) -> dict[str, Any]:
    """Return the settings of a run on the data in a folder."""
    settings = compose_settings([*defaults, *overrides]) | {"trials": str(folder)}
    return inherit_settings(OmegaConf.create(settings), given_names(overrides))


def check_report(checked: CheckedDataset, overview: Mapping[str, Any]) -> str:
    """Return the findings as an HTML page with pictures."""
    # takes a second to import
    from stringcast.stages.report.pages.check import check_page

    next_steps = []
    if overview["usable"]:
        question = "What does the simulation get wrong in these trials, and why?"
        folder = shlex.quote(str(checked.data.folder))
        arguments = f"+experiment=diagnose trials={folder}"
        next_steps.append((question, f"{program_name()} {arguments}"))
    origin = {"code": code_state(), "files": dict(checked.data.hashes)}
    return check_page(checked, overview, origin, next_steps)


def finding_of_error(fault: Exception) -> Finding:
    """Return the finding of an error that the user can correct."""
    if not isinstance(fault, ExpectedError):  # of Hydra
        return error("", "", str(fault), "")
    place, field = fault.place, fault.field
    if place.startswith("--"):
        place, field = "", place
    statement, remedy = fault.fault.removesuffix("."), fault.remedy.removesuffix(".")
    return error(place, field, statement, remedy)


def overview_of_unreadable(folder: Path, finding: Finding) -> dict[str, Any]:
    """Return the overview of data that cannot be read, with the only finding."""
    return {
        "format": 1,
        "folder": str(folder),
        "usable": False,
        "trials": [],
        "rejected": {},
        "findings": [asdict(finding)],
    }


def report_wrong_options(wrong: UserError, arguments: Sequence[str]) -> int:
    """Print an error in options as JSON if requested; otherwise raise it."""
    if "--json" not in arguments:
        raise wrong
    finding = replace(finding_of_error(wrong), file="")
    overview = overview_of_unreadable(Path(), finding) | {"folder": ""}
    print(json.dumps(overview, indent=2))
    return NOT_USABLE


def print_overview(overview: Mapping[str, Any], console: Terminal) -> None:
    """Print the findings in plain words."""
    trials, findings = overview["trials"], overview["findings"]
    if trials:
        length = overview["string_length_m"]
        heading = f"{overview['folder']}: a string of {length:.3f} m"
        console.print(heading, soft_wrap=True, markup=False)
        table = trial_table(trials)
        numbers = table.columns.drop(["trial", "begins"])
        console.print(text_table(table, right=numbers))
    for finding in findings:
        severity = finding["severity"]
        label = f"[{SEVERITY_COLOURS[severity]}]{severity}[/]"
        sentence = escape(with_program_name(Finding(**finding).sentence))
        console.print(f"{label} {sentence}", highlight=False, soft_wrap=True)
    if overview.get("effects"):
        table = effect_table(overview["effects"]).drop(columns="meaning")
        numbers = table.columns.drop(["effect", "mistaken for"])
        console.print(text_table(table, right=numbers), DETECTION_NOTE, highlight=False)
        for name, reason in overview["effects_not_tried"].items():
            console.print(f"Not tried: {name} ({reason}).", highlight=False)

    counts = []
    for severity in SEVERITY_COLOURS:
        count = sum(finding["severity"] == severity for finding in findings)
        if count:
            counts.append(format_count(count, severity))
    counted = ", ".join(counts) or "nothing looks wrong"
    conclusion = f"[bold red]Not usable[/]: {counted}."
    if overview["usable"]:
        conclusion = (
            f"[bold green]Usable[/]: {format_count(len(trials), 'trial')}; {counted}."
        )
    console.print(conclusion, soft_wrap=True)
