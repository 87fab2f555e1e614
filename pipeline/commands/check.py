"""Say what is in a folder of measured data, and whether it can be trusted."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from stringcast.data import dataset
from stringcast.data.schema import DataError
from stringcast.data.store import write_text
from stringcast.pipeline.cli.terminal import Terminal, program_name, with_program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.composition import (
    UserError,
    compose_settings,
    given_names,
)
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.check.finding import full_stop
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.check.overview import (
    DETECTION_NOTE,
    dataset_overview,
    detection_limit_text,
)
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera

USABLE, NOT_USABLE = 0, 1  # exit status
SEVERITY_COLOURS = {"error": "bold red", "warning": "yellow", "note": "dim"}


def main(arguments: Sequence[str]) -> int:
    """Look at a folder and say what was found; the exit status."""
    asked = argument_parser().parse_intermixed_args(arguments)
    console = Terminal()
    if asked.report is not None and asked.report.suffix != ".html":
        raise UserError(f"--report {asked.report}: it must end in .html. Change it.")
    try:
        there = read_measurements(asked.folder, asked.settings)
        found = dataset_overview(there)
        if asked.effects and found["usable"]:
            # which takes seconds to load
            told = import_module("stringcast.pipeline.commands.check_effects")
            found["effects"] = told.detectable_effects(asked.folder, asked.settings)
        if asked.report is not None:
            write_text(asked.report, check_report(there, found))
    except (DataError, UserError, HydraException, OmegaConfBaseException) as error:
        found = overview_of_unreadable(asked.folder, str(error))
    if asked.json:
        print(json.dumps(found, indent=2))
    else:
        print_overview(found, console)
        if asked.report is not None and asked.report.exists():
            console.print(
                str(asked.report), soft_wrap=True, markup=False, highlight=False
            )
    return USABLE if found["usable"] else NOT_USABLE


def argument_parser() -> argparse.ArgumentParser:
    """The parser of the command's arguments."""
    made = CommandParser(
        "python -m pipeline check", description=__doc__, allow_abbrev=False
    )
    made.add_argument("folder", type=Path, help="measured data, or a run's folder")
    made.add_argument(
        "settings",
        nargs="*",
        default=[],
        help="as for a run, such as string.length=0.4 or arm=mine",
    )
    made.add_argument(
        "--report",
        type=Path,
        help="a .html file to write: the same, with arm, string and clocks drawn",
    )
    made.add_argument(
        "--effects",
        action="store_true",
        help="also say from which size on each effect would be found in these trials, in half a minute",
    )
    made.add_argument(
        "--json", action="store_true", help="print all that was found as JSON"
    )
    return made


def read_measurements(folder: Path, overrides: Sequence[str]) -> CheckedDataset:
    """The data in a folder, with the arm, camera and string that a run would have."""
    config = OmegaConf.create({**compose_settings(overrides), "trials": str(folder)})
    blocks = inherit_settings(config, given_names(overrides))
    arm = build_dataclass(Arm, blocks["arm"], "arm", "conf/arm")
    camera = build_dataclass(Camera, blocks["camera"], "camera", "conf/camera")
    return CheckedDataset(
        dataset.read_dataset(folder), arm, camera, float(blocks["string"]["length"])
    )


def check_report(there: CheckedDataset, found: Mapping[str, Any]) -> str:
    """The findings as a page with pictures, HTML."""
    # which takes a second to load
    check_page = import_module("stringcast.stages.report.pages.check").check_page
    ahead = [
        (
            "What does the simulation get wrong in these trials, and why?",
            f"+experiment=diagnose trials={there.data.folder}",
        )
    ]
    following = [
        (why, f"{program_name()} {words}") for why, words in ahead if found["usable"]
    ]
    origin = {"code": code_state(), "files": dict(there.data.hashes)}
    text: str = check_page(there, found, origin, following)
    return text


def overview_of_unreadable(folder: Path, reason: str) -> dict[str, Any]:
    """The overview of data that cannot be read. reason: `file: field is so. Remedy.`,
    as all errors are written.
    """
    file, _, rest = reason.partition(": ")
    ends = [at.start() for at in re.finditer(r"\. (?=[A-Z])", rest)]
    end = next(
        (at for at in ends if rest[:at].count("(") == rest[:at].count(")")), len(rest)
    )
    said, remedy = rest[:end].removesuffix("."), rest[end + 2 :].removesuffix(".")
    field = re.match(
        r"([a-z_]+(?:\.[\w]+)+) is |.*column '([^']*)'|not valid YAML \((line \d+)",
        said,
    )
    named = next(filter(None, field.groups()), "") if field else ""
    finding: dict[str, Any] = {
        "severity": "error",
        "file": file,
        "field": named,
        "statement": said,
        "remedy": remedy,
    }
    found = [{**finding, "trials": []}]
    return {
        "format": 1,
        "folder": str(folder),
        "usable": False,
        "trials": [],
        "rejected": {},
        "findings": found,
    }


def print_overview(found: Mapping[str, Any], console: Terminal) -> None:
    """Print the findings in plain words."""
    if found["trials"]:
        console.print(
            f"{found['folder']}: a string of {found['string_length_m']:.3f} m",
            soft_wrap=True,
            markup=False,
        )
        console.print(trial_table(found["trials"]))
    for finding in found["findings"]:
        place = " ".join(filter(None, (finding["file"], finding["field"])))
        named, more = ", ".join(finding["trials"][:4]), len(finding["trials"]) - 4
        where = (
            f" (trial {named}{f' and {more} more' if more > 0 else ''})"
            if named
            else ""
        )
        remedy = (
            f" {finding['remedy']}{full_stop(finding['remedy'])}"
            if finding["remedy"]
            else ""
        )
        words = (
            f"{place}{where}: {finding['statement']}."
            if place or where
            else finding["statement"] + "."
        )
        colour, severity = SEVERITY_COLOURS[finding["severity"]], finding["severity"]
        console.print(
            f"[{colour}]{severity}[/] {escape(with_program_name(words + remedy))}",
            highlight=False,
            soft_wrap=True,
        )
    if found.get("effects"):
        console.print(effect_table(found["effects"]), DETECTION_NOTE, highlight=False)
    count = {
        s: sum(f["severity"] == s for f in found["findings"]) for s in SEVERITY_COLOURS
    }
    counted = (
        ", ".join(f"{n} {s}{'s' if n > 1 else ''}" for s, n in count.items() if n)
        or "nothing looks wrong"
    )
    usable = f"{len(found['trials'])} trial{'s' if len(found['trials']) > 1 else ''}; {counted}"
    said = (
        f"[bold green]Usable[/]: {usable}."
        if found["usable"]
        else f"[bold red]Not usable[/]: {counted}."
    )
    console.print(said, soft_wrap=True)


def trial_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """A line for each trial that can be used."""
    table = Table(box=None, pad_edge=False)
    headings = (
        "trial",
        "seen [s]",
        "with arm [s]",
        "frames",
        "per s",
        "arm per s",
        "points",
        "noise [mm]",
        "hand [m]",
    )
    for heading in headings:
        table.add_column(
            escape(heading), justify="left" if heading == "trial" else "right"
        )
    table.add_column("begins")
    for each in rows:
        rates = (
            format_number(each[name], "{:.0f}")
            for name in ("fps", "hand_rate", "points")
        )
        noise = format_number(
            None if each["noise"] is None else each["noise"] * 1e3, "{:.2f}"
        )
        times = (
            f"{each['duration']:.2f}",
            f"{each['common']:.2f}",
            str(each["frames"]),
        )
        table.add_row(
            Text(each["trial"]),
            *times,
            *rates,
            noise,
            f"{each['path']:.2f}",
            each["begins"],
        )
    return table


def effect_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """A line for each parameter that is an effect's size."""
    table = Table(box=None, pad_edge=False)
    for heading in ("effect", "found from", "tip [mm]", "like the string", "taken for"):
        table.add_column(
            escape(heading),
            justify="left" if heading in ("effect", "taken for") else "right",
        )
    for each in rows:
        tip = format_number(each["tip_m"] and each["tip_m"] * 1e3, "{:.1f}")
        name = f"{each['effect']}.{each['parameter']}"
        table.add_row(
            name,
            detection_limit_text(each),
            tip,
            f"{each['imitated']:.0%}",
            ", ".join(each["alike"]) or "-",
        )
    return table


def format_number(value: float | None, form: str) -> str:
    """A number, or a dash where it is not known."""
    return "-" if value is None else form.format(value)
