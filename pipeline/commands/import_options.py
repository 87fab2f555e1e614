"""Options of `import`: conversion to hints, and back to a command."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Sequence
from copy import deepcopy
from math import radians
from pathlib import Path
from typing import Any

from stringcast.data.importers.columns import LENGTH_UNITS
from stringcast.data.importers.reader import ColumnHints
from stringcast.pipeline.cli.command_line_hints import MAX_LENGTH_M
from stringcast.pipeline.cli.terminal import program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.commands.imported_measurements import BenchHints
from stringcast.pipeline.settings.composition import UserError

HELP_EXAMPLES = """\
examples:
  import robot.csv tracker.csv --to mine --length 300mm --links 0.25,0.20,0.135
  import robot_*.csv tracker_*.csv --to mine ...    names tell the files of a trial
  import log.csv --map t=Zeit --map q1=-A1+90 --map tip.x=X --map tip.y=Y ...
  import robot.csv film.mp4 --fps 240 --px-per-m 340 --origin-px 251.5,387.5 ...
"""


def argument_parser(description: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    parser = CommandParser(
        "python -m pipeline import",
        description=description,
        epilog=HELP_EXAMPLES,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "files",
        type=Path,
        nargs="+",
        help="logs of the arm, tables of a tracker, films",
    )
    add(
        "--to",
        type=Path,
        default=Path("imported"),
        help="the folder to write; default imported",
    )
    add(
        "--length",
        type=parse_length,
        help="of the string, grasp to tip [m]; 300mm is understood too",
    )
    add(
        "--links",
        type=parse_lengths,
        default=(),
        help="of the arm, base first [m]: 0.25,0.20,0.135",
    )
    add(
        "--base",
        type=parse_length_pair,
        default=(0.0, 0.0),
        help="where joint 1 sits [m]; default 0,0",
    )
    add(
        "--map",
        action="append",
        default=[],
        help="ours=theirs, such as q1=A1, q2=-A2+90, tip.x=X",
    )
    add(
        "--unit",
        action="append",
        default=[],
        help="of lengths: mm; or of one file: tracker.csv=mm",
    )
    angle_units = parser.add_mutually_exclusive_group()
    angle_units.add_argument(
        "--deg",
        action="store_true",
        default=None,
        help="angles are in degrees where names state no unit, or where all do",
    )
    angle_units.add_argument(
        "--rad",
        dest="deg",
        action="store_false",
        help="the same, in radians",
    )
    add(
        "--counts",
        action="store_true",
        help="joint angles are an encoder's counts, 4096 a turn",
    )
    add(
        "--absolute",
        action="store_true",
        help="joint angles count from +x, not from the link before",
    )
    add("--y-down", action="store_true", help="y of the string's points counts down")
    add(
        "--plane",
        default="",
        help="which are x and y: x,z; or -z,y where z points to the left",
    )
    add(
        "--clock",
        help="to be added to the times of points [s], or fit: by the motion of both; "
        "-0.35,0.002 also states how far it may be off, and is believed",
    )
    add(
        "--fps",
        type=float,
        help="frames a second, where times are not in the file [1/s]",
    )
    add(
        "--at",
        action="append",
        default=[],
        help="how far along the string a point is [m]: tip=0.30",
    )
    add(
        "--turn",
        type=float,
        default=0.0,
        help="to be added to the hand's direction [degrees]",
    )
    add(
        "--moving",
        action="store_true",
        help="the string moves already when trials begin",
    )
    add(
        "--geometry-measured",
        action="store_true",
        help="arm, string and directions were measured: a motion that the model of the "
        "string misses is no error",
    )
    add(
        "--hand",
        default="",
        help="the body that holds the string, where files name several",
    )
    add(
        "--skip-zeros",
        action="store_true",
        help="leave out single rows of the arm's log that are exactly zero",
    )
    add("--px-per-m", type=float, help="pixels of a metre, where places are in pixels")
    add(
        "--origin-px",
        type=parse_pixels,
        help="the world's origin in the picture [px]: 251.5,387.5",
    )
    add(
        "--yes",
        action="store_true",
        help="ask nothing: take what seems most likely, and say so",
    )
    add(
        "--json",
        action="store_true",
        help="ask nothing, and print what was found as JSON, as check does",
    )
    return parser


def expand_patterns(files: Sequence[Path]) -> list[Path]:
    """Expand patterns such as robot_*.csv in place, as shells of Windows do not.

    Existing names and patterns without a match stay.
    """
    expanded: list[Path] = []
    for file in files:
        matches = [] if file.exists() else sorted(file.parent.glob(file.name))
        expanded += matches or [file]
    return expanded


def parse_length(text: str) -> float:
    """Return a length such as 0.3, 300mm or 30cm [m]."""
    match = re.fullmatch(r"(-?[\d.]+(?:e-?\d+)?)\s*([a-z]*)", text.strip().lower())
    if not match or match[2] not in ("", *LENGTH_UNITS):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no length. Write metres, or a unit: 0.3, 300mm, 30cm"
        )
    number, unit = float(match[1]), match[2]
    if not unit and abs(number) >= MAX_LENGTH_M:
        raise argparse.ArgumentTypeError(
            f"{text} would be metres. Write {text}mm, if these are millimetres; cm and "
            "in are understood, too"
        )
    return number * LENGTH_UNITS.get(unit, 1.0)


def parse_lengths(text: str) -> tuple[float, ...]:
    """Return lengths such as 0.25,0.20 or 250,200mm [m].

    The last unit applies to lengths without one.
    """
    parts = text.split(",")
    unit = re.sub(r"[^a-z]", "", parts[-1].strip().lower())
    lengths = []
    for part in parts:
        has_unit = re.search("[a-z]", part)
        lengths.append(parse_length(part if has_unit else part + unit))
    return tuple(lengths)


def parse_pixels(text: str) -> tuple[float, float]:
    """Return a pixel position such as 251.5,387.5."""
    match = re.fullmatch(r"\s*(-?[\d.]+)\s*,\s*(-?[\d.]+)\s*", text)
    if not match:
        raise argparse.ArgumentTypeError(
            f"{text!r} are not two numbers. Write such as 251.5,387.5"
        )
    return float(match[1]), float(match[2])


def parse_length_pair(text: str) -> tuple[float, float]:
    """Return two lengths such as 0.2,0.2 [m]."""
    lengths = parse_lengths(text)
    if len(lengths) != 2:
        raise argparse.ArgumentTypeError(
            f"{text!r} are not two numbers. Write such as 0.2,0.2"
        )
    return lengths[0], lengths[1]


def read_column_hints(options: argparse.Namespace) -> ColumnHints:
    """Return the hints about columns.

    Raises UserError for an invalid unit, plane or clock.
    """
    units = {}
    for text in options.unit:
        file, _, unit = text.rpartition("=")
        if unit not in (*LENGTH_UNITS, "px"):
            raise UserError(
                f"--unit {text}",
                "no unit of lengths",
                "Write mm, cm, m or px.",
            )
        units[file] = unit
    if options.plane and not re.fullmatch(r"-?[xyz],-?[xyz]", options.plane):
        raise UserError(
            f"--plane {options.plane}",
            "it names no two directions",
            "Write such as x,z or --plane=-z,y",
        )
    clock, _ = read_clock(options.clock)
    return ColumnHints(
        parse_name_values(options.map, "--map", "q1=joint_a"),
        units,
        degrees=options.deg,
        counts=options.counts,
        absolute=options.absolute,
        y_is_down=options.y_down,
        plane=options.plane,
        fps=options.fps,
        clock=clock,
        px_per_m=options.px_per_m,
        origin_px=options.origin_px,
        hand=options.hand,
        skip_zeros=options.skip_zeros,
    )


def read_clock(text: str | None) -> tuple[float, float | None]:
    """Return the offset of `--clock` [s], and its stated error, if any."""
    if text in (None, "fit"):
        return 0.0, None
    seconds, _, error = text.partition(",")
    try:
        return float(seconds), abs(float(error)) if error else None
    except ValueError as fault:
        raise UserError(
            f"--clock {text}",
            "neither seconds nor fit",
            "Write such as --clock=-0.35, or --clock=-0.35,0.002 if it is known "
            "to 2 ms",
        ) from fault


def read_bench_hints(options: argparse.Namespace) -> BenchHints:
    """Return the hints about the bench."""
    arc_lengths = {}
    for name, text in parse_name_values(options.at, "--at", "tip=0.30"):
        arc_lengths[name] = parse_length(text)
    return BenchHints(
        length=options.length,
        links=options.links,
        base=options.base,
        point_arc_lengths=arc_lengths,
        fit_clock=options.clock == "fit",
        clock_error=read_clock(options.clock)[1],
        geometry_is_measured=options.geometry_measured,
        starts_moving=options.moving,
        hand_turn=radians(options.turn),
    )


def parse_name_values(
    texts: Sequence[str], option: str, example: str
) -> list[tuple[str, str]]:
    """Return names and values of an option that may be repeated."""
    pairs = []
    for text in texts:
        name, _, value = text.partition("=")
        if not name or not value:
            raise UserError(
                f"{option} {text}",
                "a name, = and a value are needed",
                f"Write such as {option} {example}",
            )
        pairs.append((name, value))
    return pairs


def equivalent_command(options: argparse.Namespace) -> str:
    """Return the command with the same result without questions."""
    words = ["import", *map(str, options.files), "--to", str(options.to)]
    for name, value in vars(options).items():
        if name not in ("files", "to", "yes", "json"):
            words += option_as_words(name, value)
    return f"{program_name()} {shlex.join(words)}"


def option_as_words(name: str, value: Any) -> list[str]:
    """Return an option as typed; empty for a default."""
    option = f"--{name.replace('_', '-')}"
    if name == "deg" and value is False:
        return ["--rad"]
    if value in (None, False, (), [], "") or (name, value) == ("base", (0, 0)):
        return []
    if value is True:
        return [option]
    if isinstance(value, list):
        words = []
        for item in value:
            words += [option, item]
        return words
    return [f"{option}={format_option(value)}"]


def format_option(value: Any) -> str:
    """Return the value of an option as text, numbers with nine digits."""
    if isinstance(value, tuple):
        return ",".join(map(format_option, value))
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def options_with(
    options: argparse.Namespace, words: Sequence[str]
) -> argparse.Namespace:
    """Return a copy of options with further words."""
    files = map(str, options.files)
    return argument_parser().parse_args([*words, "--", *files], deepcopy(options))


def command_with(options: argparse.Namespace, words: Sequence[str]) -> str:
    """Return the command with further options."""
    return equivalent_command(options_with(options, words))
