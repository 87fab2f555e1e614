"""Options of `import` that undo mistakes detected in files."""

from __future__ import annotations

import argparse
from functools import singledispatch

import numpy as np

from stringcast.data.importers.columns import ANGLE_UNITS, LENGTH_UNITS
from stringcast.data.importers.gather import ImportedTables
from stringcast.data.importers.reader import UsedColumn
from stringcast.stages.check.consistency.arm_place import ArmElsewhere
from stringcast.stages.check.consistency.corrections.arc_lengths import ExchangedPoints
from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.corrections.directions import (
    ExchangedAxes,
    PointDirections,
    XLeft,
    YDown,
)
from stringcast.stages.check.consistency.corrections.joints import (
    AbsoluteAngles,
    Degrees,
    EncoderCounts,
    JointConvention,
    JointOrder,
    Radians,
)
from stringcast.stages.check.consistency.corrections.lengths import WrongUnit
from stringcast.stages.check.consistency.corrections.times import PointRate
from stringcast.stages.check.consistency.string_length import WrongLength

# not stated in files, but certain: applied and reported without a question
CERTAIN_MISTAKES = (WrongUnit, PointDirections, Degrees)


def must_confirm(correction: Correction, tables: ImportedTables) -> bool:
    """Return whether a person must confirm a correction."""
    is_certain = isinstance(correction, CERTAIN_MISTAKES)
    return not is_certain or contradicts_statement(correction, tables)


def contradicts_statement(correction: Correction, tables: ImportedTables) -> bool:
    """Return whether a correction contradicts column names or options."""
    if isinstance(correction, Degrees):
        joints = [c for c in tables.used_columns if c.role.startswith("q")]
        return any(column.unit == "rad" and is_unit_stated(column) for column in joints)
    if isinstance(correction, WrongUnit):
        if {"length", "links", "base"} & {*correction.parts}:
            return True
        columns = length_columns(correction, tables)
        return any(is_unit_stated(column) for column in columns)
    return False


def is_unit_stated(column: UsedColumn) -> bool:
    """Return whether the name of a column, or an option, states its unit."""
    if column.how.startswith("--") and column.how != "--map":
        return True
    words = column.column.lower().replace("[", "_").replace("]", "_")
    parts = {part.strip("() ") for part in words.replace(" ", "_").split("_")}
    return column.unit in parts


def length_columns(correction: WrongUnit, tables: ImportedTables) -> list[UsedColumn]:
    """Return the columns whose unit a correction changes."""
    columns = []
    for column in tables.used_columns:
        if column.role in ("x", "y"):
            is_wrong = "hand" in correction.parts
        else:  # roles of points are such as tip.x
            is_length = column.role == "s" or column.role.endswith((".x", ".y"))
            is_wrong = is_length and bool({"xy", "s"} & {*correction.parts})
        if is_wrong:
            columns.append(column)
    return columns


@singledispatch
def option_words(
    correction: Correction, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options that undo a mistake; empty without any."""
    return []


@option_words.register
def unit_words(
    correction: WrongUnit, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options that state another unit of length."""
    parts, factor = {*correction.parts}, correction.factor
    words: list[str] = []
    columns = length_columns(correction, tables)
    files = {column.file.name: column.unit for column in columns}
    for file, unit in sorted(files.items()):
        right = unit_of_size(factor * LENGTH_UNITS.get(unit, np.nan))
        text = f"{file}={right}"
        if not right or text in options.unit:
            return []
        words += ["--unit", text]
    if parts & {"xy", "s", "hand"} and not files:
        return []
    if "length" in parts and options.length:
        words.append(f"--length={options.length * factor:.6g}")
    if "links" in parts and options.links:
        links = ",".join(f"{link * factor:.6g}" for link in options.links)
        words.append(f"--links={links}")
    if "base" in parts and any(options.base):
        x, y = options.base
        words.append(f"--base={x * factor:.6g},{y * factor:.6g}")
    return words


def unit_of_size(size: float) -> str:
    """Return the shortest name of the unit of this size [m]; empty without one."""
    names = []
    for name, metres in LENGTH_UNITS.items():
        if np.isclose(metres, size, rtol=1e-6):
            names.append(name)
    return min(names, key=len, default="")


@option_words.register
def y_down_words(
    correction: YDown, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option that flips y of points, unless their file holds the hand.

    It would flip the hand, too.
    """
    hand_files = {c.file for c in tables.used_columns if c.role == "y"}
    point_files = {c.file for c in tables.used_columns if c.role.endswith(".y")}
    if states_direction(options) or hand_files & point_files:
        return []
    return ["--y-down"]


@option_words.register(XLeft)
@option_words.register(ExchangedAxes)
def plane_words(
    correction: XLeft | ExchangedAxes,
    tables: ImportedTables,
    options: argparse.Namespace,
) -> list[str]:
    """Return the option of the points' plane, unless the hand is measured, too."""
    if states_direction(options) or not tables.joints:
        return []
    plane = "-x,y" if isinstance(correction, XLeft) else "y,x"
    return [f"--plane={plane}"]


def states_direction(options: argparse.Namespace) -> bool:
    """Return whether the user stated directions of x and y."""
    return bool(options.y_down or options.plane)


@option_words.register
def exchange_words(
    correction: ExchangedPoints, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options that exchange the arc lengths of two points."""
    if len(options.at) != 2:
        return []
    first, second = options.at  # e.g. tip=0.30
    first_name, _, first_s = first.partition("=")
    second_name, _, second_s = second.partition("=")
    return ["--at", f"{first_name}={second_s}", "--at", f"{second_name}={first_s}"]


@option_words.register
def degree_words(
    correction: Degrees, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option for angles in degrees, unless radians are stated."""
    return [] if options.deg is False else ["--deg"]


@option_words.register
def radian_words(
    correction: Radians, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option for angles in radians, unless degrees are stated."""
    return [] if options.deg else ["--rad"]


@option_words.register
def convention_words(
    correction: JointConvention, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options for other signs and zeros of joints."""
    if maps_joints(options) or options.absolute or options.counts:
        return []
    columns = {column.role: column for column in tables.used_columns}
    words: list[str] = []
    for name, sign, zero in zip(
        tables.joints, correction.signs, correction.zeros, strict=True
    ):
        column = columns[name]
        shift = np.radians(zero) / ANGLE_UNITS[column.unit]
        text = "-" if sign < 0 else ""
        text += column.column
        text += f"{shift:+.9g}" if zero else ""
        words += ["--map", f"{name}={text}"]
    return words


@option_words.register
def absolute_words(
    correction: AbsoluteAngles, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option for angles relative to +x."""
    return ["--absolute"]


@option_words.register
def order_words(
    correction: JointOrder, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options for another order of joints."""
    if maps_joints(options):
        return []
    column_of = columns_by_role(tables)
    words: list[str] = []
    for name, number in zip(tables.joints, correction.order, strict=True):
        words += ["--map", f"{name}={column_of[tables.joints[number]]}"]
    return words


@option_words.register
def count_words(
    correction: EncoderCounts, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options for joints in encoder counts."""
    if maps_joints(options):
        return []
    column_of = columns_by_role(tables)
    words = ["--counts"]
    if correction.zero:
        for name in tables.joints:
            words += ["--map", f"{name}={column_of[name]}-{correction.zero}"]
    return words


def columns_by_role(tables: ImportedTables) -> dict[str, str]:
    """Return the names of used columns by role."""
    return {column.role: column.column for column in tables.used_columns}


def maps_joints(options: argparse.Namespace) -> bool:
    """Return whether the user mapped joint columns."""
    return any(text.startswith("q") for text in options.map)


@option_words.register
def base_words(
    correction: ArmElsewhere, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option of the arm's base, if the motion determines it."""
    x, y = correction.place
    return [f"--base={x:g},{y:g}"] if correction.is_shown else []


@option_words.register
def length_words(
    correction: WrongLength, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option of the string's length."""
    return [f"--length={correction.length:g}"]


@option_words.register
def rate_words(
    correction: PointRate, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option of another frame rate, if the files have no times."""
    fps = options.fps
    clocks = [column for column in tables.used_columns if column.role == "t"]
    counts_frames = any(column.unit.startswith("frames") for column in clocks)
    timed_files = {column.file for column in clocks}
    point_files = {c.file for c in tables.used_columns if c.role.endswith(".x")}
    if fps and (counts_frames or not point_files <= timed_files):
        return ["--fps", f"{fps / correction.factor:g}"]
    return []
