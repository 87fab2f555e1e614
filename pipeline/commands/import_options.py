"""The options of `import`: read as hints about columns and the bench, and written again
as the command meant.
"""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Sequence
from math import radians
from pathlib import Path
from typing import Any

from stringcast.data.importers.columns import LENGTH_UNITS
from stringcast.data.importers.reader import ColumnHints
from stringcast.pipeline.cli.command_line_hints import MAX_LENGTH_M
from stringcast.pipeline.cli.terminal import program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.commands.dataset_import import BenchHints
from stringcast.pipeline.settings.composition import UserError

HELP_EXAMPLES = """\
examples:
  import robot.csv tracker.csv --to mine --length 300mm --links 0.25,0.20,0.135 --base 0,0
  import robot_*.csv tracker_*.csv --to mine ...       files of one trial are called alike
  import log.csv --map t=Zeit --map q1=-A1+90 --map tip.x=spitze_x --map tip.y=spitze_y ...
  import robot.csv film.mp4 --fps 240 --px-per-m 340 --origin-px 251.5,387.5 ...
"""


def argument_parser(description: str | None = None) -> argparse.ArgumentParser:
    """The parser of the command's arguments. description: of the command."""
    made = CommandParser(
        *("python -m pipeline import", None, description, HELP_EXAMPLES),
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument(
        "files",
        type=Path,
        nargs="+",
        help="logs of the arm, tables of a tracker, films",
    )
    made.add_argument(
        "--to",
        type=Path,
        default=Path("imported"),
        help="the folder to write; default imported",
    )
    made.add_argument(
        "--length",
        type=parse_length,
        help="of the string, grasp to tip [m]; 300mm is understood too",
    )
    made.add_argument(
        "--links",
        type=parse_lengths,
        default=(),
        help="of the arm, base first [m]: 0.25,0.20,0.135",
    )
    made.add_argument(
        "--base",
        type=parse_length_pair,
        default=(0.0, 0.0),
        help="where joint 1 sits [m]; default 0,0",
    )
    made.add_argument(
        "--map",
        action="append",
        default=[],
        help="ours=theirs, such as q1=A1, q2=-A2+90, tip.x=X",
    )
    made.add_argument(
        "--unit",
        action="append",
        default=[],
        help="of lengths: mm; or of one file: tracker.csv=mm",
    )
    turned = made.add_mutually_exclusive_group()
    turned.add_argument(
        "--deg",
        action="store_true",
        default=None,
        help="angles without a unit are in degrees",
    )
    turned.add_argument(
        "--rad",
        dest="deg",
        action="store_false",
        help="angles without a unit are in radians",
    )
    made.add_argument(
        "--y-down", action="store_true", help="y of the string's points is counted down"
    )
    made.add_argument(
        "--plane",
        default="",
        help="which are x and y: x,z; or -z,y where z points to the left",
    )
    made.add_argument(
        "--clock",
        help="to be added to the times of points [s], or fit: by the motion of both",
    )
    made.add_argument(
        "--fps",
        type=float,
        help="frames a second, where times are not in the file [1/s]",
    )
    made.add_argument(
        "--at",
        action="append",
        default=[],
        help="how far along the string a point is [m]: tip=0.30",
    )
    made.add_argument(
        "--turn",
        type=float,
        default=0.0,
        help="to be added to the hand's direction [degrees]",
    )
    made.add_argument(
        "--moving",
        action="store_true",
        help="the string swings already when trials begin",
    )
    made.add_argument(
        "--px-per-m", type=float, help="pixels of a metre, where places are in pixels"
    )
    made.add_argument(
        "--origin-px",
        type=parse_pixels,
        help="the world's origin in the picture [px]: 251.5,387.5",
    )
    made.add_argument(
        "--yes",
        action="store_true",
        help="ask nothing: take what seems most likely, and say so",
    )
    return made


def expand_patterns(files: Sequence[Path]) -> list[Path]:
    """The files, those of a pattern such as robot_*.csv in its place: shells of Windows
    hand it on as it is. What is there by that very name, or not at all, stays as it was
    said.
    """
    return [
        one
        for file in files
        for one in ([] if file.exists() else sorted(file.parent.glob(file.name)))
        or [file]
    ]


def parse_length(text: str) -> float:
    """A length such as 0.3, 300mm or 30cm [m]."""
    match = re.fullmatch(r"(-?[\d.]+(?:e-?\d+)?)\s*([a-z]*)", text.strip().lower())
    if not match or match[2] not in ("", *LENGTH_UNITS):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no length. Write metres, or a unit: 0.3, 300mm, 30cm"
        )
    if not match[2] and abs(float(match[1])) >= MAX_LENGTH_M:
        raise argparse.ArgumentTypeError(
            f"{text} would be metres. Write {text}mm, if these are millimetres"
        )
    return float(match[1]) * LENGTH_UNITS.get(match[2], 1.0)


def parse_lengths(text: str) -> tuple[float, ...]:
    """Lengths such as 0.25,0.20 or 250,200mm [m]: a unit behind the last is that of
    all.
    """
    *rest, last = text.split(",")
    unit = re.sub(r"[^a-z]", "", last.strip().lower())
    return tuple(
        parse_length(part if re.search("[a-z]", part) else part + unit)
        for part in (*rest, last)
    )


def parse_pixels(text: str) -> tuple[float, float]:
    """A place in a picture such as 251.5,387.5 [px]."""
    match = re.fullmatch(r"\s*(-?[\d.]+)\s*,\s*(-?[\d.]+)\s*", text)
    if not match:
        raise argparse.ArgumentTypeError(
            f"{text!r} are not two numbers. Write such as 251.5,387.5"
        )
    return float(match[1]), float(match[2])


def parse_length_pair(text: str) -> tuple[float, float]:
    """Two lengths such as 0.2,0.2 [m]."""
    both = parse_lengths(text)
    if len(both) != 2:
        raise argparse.ArgumentTypeError(
            f"{text!r} are not two numbers. Write such as 0.2,0.2"
        )
    return both[0], both[1]


def read_column_hints(asked: argparse.Namespace) -> ColumnHints:
    """The options that describe columns. Raises UserError for a unit or a plane that
    there is none of.
    """
    columns = dict(parse_name_values(asked.map, "--map", "q1=joint_a"))
    unit = dict(
        text.rsplit("=", 1) if "=" in text else ("", text) for text in asked.unit
    )
    for name, one in unit.items():
        if one not in (*LENGTH_UNITS, "px"):
            raise UserError(
                f"--unit {name}{'=' * bool(name)}{one}: no unit of lengths. Write mm, cm, m or px."
            )
    if asked.plane and not re.fullmatch(r"-?[xyz],-?[xyz]", asked.plane):
        raise UserError(
            f"--plane {asked.plane}: it names no two directions. Write such as x,z or --plane=-z,y"
        )
    try:
        clock = 0.0 if asked.clock in (None, "fit") else float(asked.clock)
    except ValueError as error:
        raise UserError(
            f"--clock {asked.clock}: neither seconds nor fit. Write such as --clock=-0.35"
        ) from error
    return ColumnHints(
        columns,
        unit,
        degrees=asked.deg,
        y_is_down=asked.y_down,
        plane=asked.plane,
        fps=asked.fps,
        clock=clock,
        px_per_m=asked.px_per_m,
        origin_px=asked.origin_px,
    )


def read_bench_hints(asked: argparse.Namespace) -> BenchHints:
    """The options that describe the bench."""
    at = {
        name: parse_length(text)
        for name, text in parse_name_values(asked.at, "--at", "tip=0.30")
    }
    return BenchHints(
        length=asked.length,
        links=asked.links,
        base=asked.base,
        point_arc_lengths=at,
        fit_clock=asked.clock == "fit",
        starts_moving=asked.moving,
        hand_turn=radians(asked.turn),
        fps=asked.fps,
        px_per_m=asked.px_per_m,
        origin_px=asked.origin_px,
    )


def parse_name_values(
    texts: Sequence[str], option: str, example: str
) -> list[tuple[str, str]]:
    """Names and values of an option that may be given again and again."""
    pairs = [tuple(text.split("=", 1)) for text in texts]
    for words in pairs:
        if len(words) != 2 or not all(words):
            raise UserError(
                f"{option} {'='.join(words)}: a name, = and a value are needed, such as {option} {example}"
            )
    return [(name, value) for name, value in pairs]


def equivalent_command(asked: argparse.Namespace) -> str:
    """The command that needs no questions any more."""
    words = ["import", *map(str, asked.files), "--to", str(asked.to)]
    options: dict[str, Any] = vars(asked)
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        if (
            name in ("files", "to", "yes")
            or value in (None, False, (), [], 0.0, "")
            or (name, value) == ("base", (0, 0))
        ):
            words += ["--rad"] if (name, value) == ("deg", False) else []
        elif value is True:
            words += [option]
        elif isinstance(value, list):
            words += [word for one in value for word in (option, one)]
        else:
            words += [f"{option}={format_option(value)}"]
    return f"{program_name()} {shlex.join(words)}"


def format_option(value: Any) -> str:
    """A value of an option: of numbers, nine figures."""
    if isinstance(value, tuple):
        return ",".join(map(format_option, value))
    return f"{value:.9g}" if isinstance(value, float) else str(value)
