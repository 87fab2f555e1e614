"""Make a dataset of logs and trackers' tables: say what was understood, draw it, write the folder."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from math import isnan, radians
from os.path import commonprefix
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.table import Table
from rich.text import Text

from stringcast.data.importers.columns import LENGTHS
from stringcast.data.importers.files import recordings
from stringcast.data.importers.gathered import Gathered, gathered
from stringcast.data.importers.reader import ColumnHints, Taken
from stringcast.data.importers.recording import Recording
from stringcast.data.schema import DataError
from stringcast.data.store import whole
from stringcast.pipeline.called import called_as
from stringcast.pipeline.commands import Arguments, check
from stringcast.pipeline.importing import BenchHints, Imported, imported, written
from stringcast.pipeline.mistakes import FARTHEST
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.measured import Measured
from stringcast.stages.check.mistakes import Mistake, explanations, impossible

TRIES = 6  # as many things can be unclear one after another: units of points and hand, degrees, direction, clock
EXAMPLES = """\
examples:
  import robot.csv tracker.csv --to mine --length 300mm --links 0.25,0.20,0.135 --base 0,0
  import robot_*.csv tracker_*.csv --to mine ...       files of one trial are called alike
  import log.csv --map t=Zeit --map q1=-A1+90 --map tip.x=spitze_x --map tip.y=spitze_y ...
  import robot.csv film.mp4 --fps 240 --px-per-m 340 --origin-px 251.5,387.5 ...
"""


def main(arguments: Sequence[str]) -> int:
    """Read, show, write; 0 where a folder that can be used was written."""
    asked = parser().parse_args(arguments)
    folder: Path = asked.to
    if folder.exists():
        raise UserError(f"--to {folder}: it is there already. Name another folder, or remove it: rm -r {folder}")
    console, read = Terminal(), recordings(asked.files)
    what, made, measured = understood(read, asked, console)
    console.print(columns(what))
    for note in made.notes:
        console.print(f"[yellow]note[/] {note}.", highlight=False, soft_wrap=True)
    picture = drawn(measured, folder)
    found = check.overview(measured)
    check.show(found | {"folder": str(folder)}, console)
    if picture is not None:
        console.print(f"What was understood, drawn: {picture}", soft_wrap=True, markup=False)
    if not found["usable"]:
        first = next((f for f in found["findings"] if f["severity"] == Severity.ERROR), None)
        remedy = f" {first['remedy']}." if first else ""
        raise DataError(f"{folder}: it was not written, for nothing could be learnt from it as it is.{remedy}")
    with whole(folder) as aside:
        written(made, aside, asked.files, command(asked))
    again = shlex.quote(str(folder))
    console.print(f"Written: {folder}. The same again: {command(asked)}", soft_wrap=True, markup=False)
    console.print(f"Next: {called_as()} +experiment=diagnose trials={again}", soft_wrap=True, markup=False)
    return 0


def parser() -> argparse.ArgumentParser:
    """The parser of the command's arguments."""
    made = Arguments(
        *("python -m pipeline import", None, __doc__, EXAMPLES),
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("files", type=Path, nargs="+", help="logs of the arm, tables of a tracker, films")
    made.add_argument("--to", type=Path, default=Path("imported"), help="the folder to write; default imported")
    made.add_argument("--length", type=metres, help="of the string, grasp to tip [m]; 300mm is understood too")
    made.add_argument("--links", type=several, default=(), help="of the arm, base first [m]: 0.25,0.20,0.135")
    made.add_argument("--base", type=pair, default=(0.0, 0.0), help="where joint 1 sits [m]; default 0,0")
    made.add_argument("--map", action="append", default=[], help="ours=theirs, such as q1=A1, q2=-A2+90, tip.x=X")
    made.add_argument("--unit", action="append", default=[], help="of lengths: mm; or of one file: tracker.csv=mm")
    turned = made.add_mutually_exclusive_group()
    turned.add_argument("--deg", action="store_true", default=None, help="angles without a unit are in degrees")
    turned.add_argument("--rad", dest="deg", action="store_false", help="angles without a unit are in radians")
    made.add_argument("--y-down", action="store_true", help="y of the string's points is counted down")
    made.add_argument("--plane", default="", help="which are x and y: x,z; or -z,y where z points to the left")
    made.add_argument("--clock", help="to be added to the times of points [s], or fit: by the motion of both")
    made.add_argument("--fps", type=float, help="frames a second, where times are not in the file [1/s]")
    made.add_argument("--at", action="append", default=[], help="how far along the string a point is [m]: tip=0.30")
    made.add_argument("--turn", type=float, default=0.0, help="to be added to the hand's direction [degrees]")
    made.add_argument("--moving", action="store_true", help="the string swings already when trials begin")
    made.add_argument("--px-per-m", type=float, help="pixels of a metre, where places are in pixels")
    made.add_argument("--origin-px", type=pixels, help="the world's origin in the picture [px]: 251.5,387.5")
    made.add_argument("--yes", action="store_true", help="ask nothing: take what seems most likely, and say so")
    return made


def metres(text: str) -> float:
    """A length such as 0.3, 300mm or 30cm [m]."""
    match = re.fullmatch(r"(-?[\d.]+(?:e-?\d+)?)\s*([a-z]*)", text.strip().lower())
    if not match or match[2] not in ("", *LENGTHS):
        raise argparse.ArgumentTypeError(f"{text!r} is no length. Write metres, or a unit: 0.3, 300mm, 30cm")
    if not match[2] and abs(float(match[1])) >= FARTHEST:
        raise argparse.ArgumentTypeError(f"{text} would be metres. Write {text}mm, if these are millimetres")
    return float(match[1]) * LENGTHS.get(match[2], 1.0)


def several(text: str) -> tuple[float, ...]:
    """Lengths such as 0.25,0.20 or 250,200mm [m]: a unit behind the last is that of all."""
    *rest, last = text.split(",")
    unit = re.sub(r"[^a-z]", "", last.strip().lower())
    return tuple(metres(part if re.search("[a-z]", part) else part + unit) for part in (*rest, last))


def pixels(text: str) -> tuple[float, float]:
    """Such as 251.5,387.5 [px]."""
    match = re.fullmatch(r"\s*(-?[\d.]+)\s*,\s*(-?[\d.]+)\s*", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} are not two numbers. Write such as 251.5,387.5")
    return float(match[1]), float(match[2])


def pair(text: str) -> tuple[float, float]:
    """Two of them."""
    both = several(text)
    if len(both) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} are not two numbers. Write such as 0.2,0.2")
    return both[0], both[1]


def understood(
    read: Sequence[Recording], asked: argparse.Namespace, console: Terminal
) -> tuple[Gathered, Imported, Measured]:
    """The recordings with their interpretation. Where a wrong unit, direction or clock would explain why data cannot be
    right, that is asked on a terminal, and else assumed where no option says otherwise. `asked` is changed by it."""
    with TemporaryDirectory() as place:
        for number in range(TRIES):
            what = gathered(read, column_hints(asked))
            made = imported(what, bench_hints(asked))
            folder = Path(place) / str(number)
            change: Change | None
            if made.apart:
                change = _apart(made, asked)
            else:
                written(made, folder, asked.files, "")
                measured = check.measured(folder, [])
                contradictory = impossible(measured)
                likely = explanations(measured, contradictory) if contradictory else []
                undoing = (_undoing(mistake, what, asked) for mistake in (likely[0] if likely else ()))
                change = next(filter(None, undoing), None)
            if change is None:
                return what, made, measured
            _agree(*change, asked, console)
    raise DataError("It stays unclear in which units and directions these files are. Say it: see import --help.")


Change = tuple[str, str, Callable[[], object]]  # what seems so, the option that says it, and what it does


def _apart(made: Imported, asked: argparse.Namespace) -> Change:
    """Clocks that have nothing in common are laid over one another."""
    if asked.clock is not None:
        raise DataError(f"--clock {asked.clock}: trial {made.apart[0]} of arm and camera are still not of one time.")
    name = made.apart[0]
    hand, seen = (table.loc[table["trial"] == name, "t"] for table in (made.motion, made.points))
    why = (
        f"arm and camera have no time in common: in trial {name} the arm's clock goes from {hand.min():.2f} to "
        f"{hand.max():.2f} s, the camera's from {seen.min():.2f} to {seen.max():.2f} s"
    )
    return why, "--clock fit", lambda: setattr(asked, "clock", "fit")


def _undoing(mistake: Mistake, what: Gathered, asked: argparse.Namespace) -> Change | None:
    """The option that undoes a mistake, if there is one and the files do not say themselves what is so."""
    if mistake.option == "--deg":
        changes = asked.deg is None and any(one.unit == "rad" and one.how == "name" for one in what.taken)
        return (mistake.said, "--deg", lambda: setattr(asked, "deg", True)) if changes else None
    if mistake.option == "--y-down":
        return (
            None if asked.y_down or asked.plane else (mistake.said, "--y-down", lambda: setattr(asked, "y_down", True))
        )
    if mistake.option:
        plane = mistake.option.partition("=")[2]
        return None if asked.plane else (mistake.said, mistake.option, lambda: setattr(asked, "plane", plane))
    if not mistake.parts or not {*mistake.parts} <= {"xy", "s", "hand", "length"}:
        return None
    unit = next(unit for unit, factor in LENGTHS.items() if factor == mistake.factor)
    return _of_unit(mistake, unit, what, asked)


def _of_unit(mistake: Mistake, unit: str, what: Gathered, asked: argparse.Namespace) -> Change | None:
    """Lengths of some files in another unit, where neither their columns nor a person say in which."""
    roles = {"xy": "point", "s": "point", "hand": "hand"}
    wanted = {roles[part] for part in mistake.parts if part in roles}
    files = {one.file.name for one in what.taken if one.unit == "m" and _kind(one.role) in wanted}
    said = [f"{file}={unit}" for file in sorted(files)]
    if not files or any(text in asked.unit for text in said):
        return None
    return mistake.said, " ".join(f"--unit {text}" for text in said), lambda: asked.unit.extend(said)


def _kind(role: str) -> str:
    """Whether a role is of the hand or of points."""
    return "hand" if role in ("x", "y") else "point" if role == "s" or role.endswith((".x", ".y")) else ""


def _agree(why: str, option: str, change: Callable[[], object], asked: argparse.Namespace, console: Terminal) -> None:
    """Change what was asked for, after a yes where somebody can be asked."""
    console.print(f"[yellow]It seems:[/] {why}.", highlight=False, soft_wrap=True)
    if sys.stdin.isatty() and not asked.yes:
        if input(f"Take it as {option}? [Y/n] ").strip().lower() not in ("", "y", "yes"):
            raise UserError("Nothing was written. Say what is so: see import --help.")
    else:
        console.print(f"Taken as {option}.", highlight=False, markup=False)
    change()


def column_hints(asked: argparse.Namespace) -> ColumnHints:
    """The options that describe columns. Raises UserError for a unit or a plane that there is none of."""
    columns = dict(_pairs(asked.map, "--map", "q1=joint_a"))
    unit = dict(text.rsplit("=", 1) if "=" in text else ("", text) for text in asked.unit)
    for name, one in unit.items():
        if one not in (*LENGTHS, "px"):
            raise UserError(f"--unit {name}{'=' * bool(name)}{one}: no unit of lengths. Write mm, cm, m or px.")
    if asked.plane and not re.fullmatch(r"-?[xyz],-?[xyz]", asked.plane):
        raise UserError(f"--plane {asked.plane}: it names no two directions. Write such as x,z or --plane=-z,y")
    try:
        clock = 0.0 if asked.clock in (None, "fit") else float(asked.clock)
    except ValueError as error:
        raise UserError(f"--clock {asked.clock}: neither seconds nor fit. Write such as --clock=-0.35") from error
    return ColumnHints(
        *(columns, unit, asked.deg, asked.y_down, asked.plane),
        *(asked.fps, clock, asked.px_per_m, asked.origin_px),
    )


def bench_hints(asked: argparse.Namespace) -> BenchHints:
    """The options that describe the bench."""
    at = {name: metres(text) for name, text in _pairs(asked.at, "--at", "tip=0.30")}
    return BenchHints(
        *(asked.length, asked.links, asked.base, at, asked.clock == "fit", asked.moving),
        *(radians(asked.turn), asked.fps, asked.px_per_m, asked.origin_px),
    )


def _pairs(texts: Sequence[str], option: str, example: str) -> list[tuple[str, str]]:
    """Names and values of an option that may be given again and again."""
    pairs = [tuple(text.split("=", 1)) for text in texts]
    for words in pairs:
        if len(words) != 2 or not all(words):
            raise UserError(f"{option} {'='.join(words)}: a name, = and a value are needed, such as {option} {example}")
    return [(name, value) for name, value in pairs]


def command(asked: argparse.Namespace) -> str:
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
            words += [f"{option}={_written(value)}"]
    return f"{called_as()} {shlex.join(words)}"


def _written(value: Any) -> str:
    """A value of an option: of numbers, nine figures."""
    if isinstance(value, tuple):
        return ",".join(map(_written, value))
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def columns(what: Gathered) -> Table:
    """A table of the columns as they were read, and of those left out; files of the same columns as one."""
    table = Table(box=None, pad_edge=False)
    for heading in ("file", "column", "taken as", "from", "to"):
        table.add_column(Text(heading), justify="right" if heading in ("from", "to") else "left", overflow="fold")
    alike: dict[tuple[str, ...], list[Taken]] = {}
    for one in what.taken:
        unit = f" [{one.unit}]" if one.unit else ""
        alike.setdefault((one.column, f"{one.role}{unit}, by {one.how}"), []).append(one)
    for (column, role), those in alike.items():
        first = those[0]
        unit = {"t": " s", "theta": " rad", "trial": ""}.get(first.role, " rad" if first.role.startswith("q") else " m")
        ours = "" if first.unit in ("1", "px") or first.role.endswith("valid") else unit
        ends = [] if isnan(those[0].low) else [min(one.low for one in those), max(one.high for one in those)]
        cells = [_files([one.file for one in those]), column, role, *(f"{end:.4g}{ours}" for end in ends)]
        table.add_row(*map(Text, cells))
    left = {tuple(map(str, names)): [f for f, n in what.left.items() if n == names] for names in what.left.values()}
    for names, files in left.items():
        if names:
            table.add_row(*map(Text, (_files(files), ", ".join(names), "left out")))
    return table


def _files(files: Sequence[Path]) -> str:
    """Names of files, several by what they have in common."""
    names = list(dict.fromkeys(file.name for file in files))
    begin = commonprefix(names)  # noqa: RUF071 (of characters)
    return names[0] if len(names) == 1 else f"{begin.rstrip('0123456789')}* ({len(names)})"


def drawn(measured: Measured, folder: Path) -> Path | None:
    """The path of a picture beside the folder, of the first trial of which points were measured."""
    from stringcast.stages.report.charts.measured import trial_figure  # noqa: PLC0415

    seen = next(measured.with_points(), None)
    if seen is None:
        return None
    path = folder.with_name(f"{folder.name}.png")
    with whole(path) as aside:
        trial_figure(seen).savefig(aside, format="png", dpi=110)
    return path
