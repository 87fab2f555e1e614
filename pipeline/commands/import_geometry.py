"""Geometry of files to import: what contradicts itself, and the options for it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
import pandas as pd

from stringcast.data.importers.columns import LENGTH_UNITS
from stringcast.data.importers.gather import ImportedTables
from stringcast.data.importers.reader import UsedColumn
from stringcast.data.schema import DataError
from stringcast.pipeline.commands.dataset_import import (
    BenchHints,
    imported_grasp_poses,
)
from stringcast.pipeline.commands.import_options import (
    argument_parser,
    equivalent_command,
)
from stringcast.stages.check.consistency.check import (
    describe_contradiction,
    describe_fit,
)
from stringcast.stages.check.consistency.corrections import Correction
from stringcast.stages.check.consistency.judge import Verdict, judge
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.check.consistency.search import Proposal, find_answer
from stringcast.stages.check.measured import drop_spikes

MIN_ROWS = 5  # of a table: fewer show nothing
MAX_FLAT_SHARE = 0.02  # of the other coordinate's range: one that never changes
MAX_PLACES = 6  # of stated arc length that are looked at
# what the files leave open, and one answer is certain: it is taken and said
CERTAIN_KINDS = {"unit", "y_down", "x_left", "exchange_axes", "degrees"}


TABLE_WORDS = {
    "points": "points of the string",
    "arm": "the arm's log",
    "grasp": "hand",
    "arm, points": "the arm's log and points of the string",
}


class Change(NamedTuple):
    """Options that would explain why the data contradict themselves.

    must_ask: whether a person has to confirm them. file, field: what they concern.
    """

    reason: str
    words: list[str]
    must_ask: bool = False
    file: str = ""
    field: str = ""


def propose_geometry(
    tables: ImportedTables, bench: BenchHints, options: argparse.Namespace
) -> Change | None:
    """Return the options that make files consistent; None if they are.

    None also stands for files that nothing makes consistent: the checks of the dataset
    report them, with a drawing.

    Raises DataError if several corrections fit, or one that no option performs.
    """
    measured = measurements_of_tables(tables, bench)
    if measured is None:
        return None
    verdict = judge(measured)
    answer = find_answer(measured, verdict)
    if answer.pairing:
        refuse_pairing(answer.pairing)
    proposals = answer.proposals
    if verdict.is_consistent and not proposals:
        return None
    refuse_flat_points(measured)
    if not proposals:
        refuse_point_inside(measured)
        return None
    changes = [change_of(p, verdict, tables, options) for p in proposals]
    if len(changes) > 1:
        refuse_ambiguity(verdict, proposals, changes, options)
    return changes[0]


def measurements_of_tables(
    tables: ImportedTables, bench: BenchHints
) -> Measurements | None:
    """Return what files hold as measurements; None if it cannot be judged."""
    grasp = imported_grasp_poses(tables, bench)  # refuses missing links
    if tables.points.empty:
        return None
    points = tables.points
    if "valid" in points:
        points = points[points["valid"].fillna(True).astype(bool)]
    points = points[np.isfinite(points[["t", "x", "y"]]).all(axis=1)]
    motion = tables.motion if tables.joints else grasp
    columns = tables.joints or ["x", "y", "theta"]
    motion = motion[np.isfinite(motion[["t", *columns]]).all(axis=1)]
    recordings = []
    for name, rows in motion.groupby("trial"):
        log = rows.drop_duplicates("t").sort_values("t")
        tracks = tracks_of(points[points["trial"] == name], bench)
        if len(log) < MIN_ROWS or not tracks:
            continue
        values = log[columns].to_numpy(float)
        joints, hand = (values, None) if tables.joints else (None, values)
        t = log["t"].to_numpy()
        moving = bench.starts_moving
        recordings.append(Recording(str(name), t, joints, hand, tracks, moving))
    if not recordings:
        return None
    return Measurements(
        tuple(recordings),
        bench.links,
        bench.base,
        bench.length,
        base_is_measured=bench.geometry_is_measured,
    )


def tracks_of(points: pd.DataFrame, bench: BenchHints) -> tuple[Track, ...]:
    """Return the tracks of a trial's points, of a few if their arc length is stated."""
    tracks = []
    groups: list[tuple[str, float | None, pd.Series]] = []
    if "s" in points:
        places = np.sort(points["s"].round(4).unique())
        if len(places) > MAX_PLACES:
            wanted = np.array([0.25, 0.5, 1.0]) * np.quantile(places, 0.95)
            nearest = np.abs(places[:, None] - wanted).argmin(axis=0)
            places = places[np.unique(nearest)]
        for s in places:
            groups.append((f"{s:g}", float(s), points["s"].round(4) == s))
    else:
        for name in points["point"].unique():
            s = bench.point_arc_lengths.get(name)
            groups.append((str(name), s, points["point"] == name))
    for name, s, is_here in groups:
        rows = points[is_here].drop_duplicates("t").sort_values("t")
        if len(rows) >= MIN_ROWS:
            xy = rows[["x", "y"]].to_numpy(float)
            tracks.append(Track(name, s, *drop_spikes(rows["t"].to_numpy(), xy)))
    return tuple(tracks)


# --- options -----------------------------------------------------------------


def change_of(
    proposal: Proposal,
    before: Verdict,
    tables: ImportedTables,
    options: argparse.Namespace,
) -> Change:
    """Return the options that perform a proposal.

    Raises DataError, with what to do instead, if no option does.
    """
    corrections = proposal.corrections
    words_of_each = [option_words(c, tables, options) for c in corrections]
    statements = statements_for_files(proposal)
    contradiction, fit = describe_contradiction(before), describe_fit(proposal.verdict)
    reason = (
        f"{statements}. As the files are read now, {contradiction}; corrected, {fit}"
    )
    if not all(words_of_each):
        remedies = ". ".join(correction.remedy for correction in corrections)
        if must_state_otherwise(proposal, options):
            remedies = "Look at --y-down and --plane, which are given"
        raise DataError(f"{reason}. {remedies}.")
    must_ask = any(
        correction.kind not in CERTAIN_KINDS
        or contradicts_statement(correction, tables)
        for correction in corrections
    )
    files = dict.fromkeys(table_files(c.table, tables) for c in corrections)
    fields = dict.fromkeys(correction.field for correction in corrections)
    return Change(
        reason,
        words=list(chain.from_iterable(words_of_each)),
        must_ask=must_ask,
        file=", ".join(filter(None, files)),
        field=", ".join(fields),
    )


def table_files(table: str, tables: ImportedTables) -> str:
    """Return the files that make a table of the dataset; empty if options make it."""
    names = []
    for column in tables.used_columns:
        is_point = column.role.endswith((".x", ".y")) or column.role == "s"
        is_hand = column.role in ("x", "y", "theta") or column.role.startswith("q")
        if (table == "points" and is_point) or (table in ("arm", "grasp") and is_hand):
            names.append(column.file.name)
    return ", ".join(dict.fromkeys(names))


def statements_for_files(proposal: Proposal) -> str:
    """Return all that is wrong, with the places where it is."""
    statements = []
    for correction in proposal.corrections:
        table = TABLE_WORDS.get(correction.table, "the stated geometry")
        field = correction.field.removeprefix("string.").removeprefix("arm.")
        statements.append(f"{table}, {field}: {correction.statement}")
    return " and ".join(statements)


def must_state_otherwise(proposal: Proposal, options: argparse.Namespace) -> bool:
    """Return whether a direction is wrong that the user stated."""
    kinds = {correction.kind for correction in proposal.corrections}
    directions = {"y_down", "x_left", "exchange_axes"}
    return bool(kinds & directions and (options.y_down or options.plane))


def contradicts_statement(correction: Correction, tables: ImportedTables) -> bool:
    """Return whether names of columns or options state what is wrong."""
    if correction.kind == "degrees":
        joints = [c for c in tables.used_columns if c.role.startswith("q")]
        return any(column.unit == "rad" and is_unit_stated(column) for column in joints)
    if correction.kind == "unit":
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


def length_columns(correction: Correction, tables: ImportedTables) -> list[UsedColumn]:
    """Return the columns whose unit a correction changes."""
    columns = []
    for column in tables.used_columns:
        if column.role in ("x", "y"):
            is_wrong = "hand" in correction.parts
        else:  # a point's roles are such as tip.x
            is_length = column.role == "s" or column.role.endswith((".x", ".y"))
            is_wrong = is_length and bool({"xy", "s"} & {*correction.parts})
        if is_wrong:
            columns.append(column)
    return columns


def option_words(
    correction: Correction, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options that perform a correction; empty if none does."""
    words: list[str] = []
    match correction.kind:
        case "unit":
            words = unit_words(correction, tables, options)
        case "y_down" | "x_left" | "exchange_axes":
            words = direction_words(correction.kind, tables, options)
        case "exchange_s" if len(options.at) == 2:
            words = exchange_words(*options.at)
        case "degrees" if options.deg is not False:  # no radians are stated
            words = ["--deg"]
        case "absolute":
            words = ["--absolute"]
        case "counts" | "joint_order":
            words = joint_words(correction, tables, options)
        case "base" if correction.values:
            x, y = correction.values
            words = [f"--base={x:g},{y:g}"]
        case "rate":
            words = rate_words(correction.factor, tables, options)
    return words


def exchange_words(first: str, second: str) -> list[str]:
    """Return the options that exchange the arc lengths of two points.

    first, second: the values of `--at` that place them, such as tip=0.30.
    """
    first_name, _, first_s = first.partition("=")
    second_name, _, second_s = second.partition("=")
    return ["--at", f"{first_name}={second_s}", "--at", f"{second_name}={first_s}"]


def direction_words(
    kind: str, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option that turns the points' directions, not those of a hand.

    `--plane` would turn a measured hand, too, and `--y-down` one in the same file.
    """
    if options.y_down or options.plane:
        return []
    if kind == "y_down":
        hand_files = {c.file for c in tables.used_columns if c.role == "y"}
        point_files = {c.file for c in tables.used_columns if c.role.endswith(".y")}
        return [] if hand_files & point_files else ["--y-down"]
    planes = {"x_left": "--plane=-x,y", "exchange_axes": "--plane=y,x"}
    return [planes[kind]] if tables.joints else []


def rate_words(
    factor: float, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the option that states another frame rate, if no times are in files.

    factor: by which the times of points are multiplied.
    """
    fps = options.fps
    clocks = [column for column in tables.used_columns if column.role == "t"]
    counts_frames = any(column.unit.startswith("frames") for column in clocks)
    timed_files = {column.file for column in clocks}
    point_files = {c.file for c in tables.used_columns if c.role.endswith(".x")}
    if fps and (counts_frames or not point_files <= timed_files):
        return ["--fps", f"{fps / factor:g}"]
    return []


def unit_words(
    correction: Correction, tables: ImportedTables, options: argparse.Namespace
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
    """Return the shortest name of the unit of this size [m]; empty if there is none."""
    names = []
    for name, metres in LENGTH_UNITS.items():
        if np.isclose(metres, size, rtol=1e-6):
            names.append(name)
    return min(names, key=len, default="")


def joint_words(
    correction: Correction, tables: ImportedTables, options: argparse.Namespace
) -> list[str]:
    """Return the options that take joints in another order, or as counts."""
    if any(text.startswith("q") for text in options.map):
        return []
    column_of = {c.role: c.column for c in tables.used_columns}
    names = tables.joints
    words: list[str] = []
    if correction.kind == "joint_order":
        for name, number in zip(names, correction.order, strict=True):
            words += ["--map", f"{name}={column_of[names[number]]}"]
        return words
    words.append("--counts")
    if correction.zero:
        for name in names:
            words += ["--map", f"{name}={column_of[name]}-{correction.zero}"]
    return words


def options_with(
    options: argparse.Namespace, words: Sequence[str]
) -> argparse.Namespace:
    """Return a copy of options with further words."""
    files = map(str, options.files)
    return argument_parser().parse_args([*words, "--", *files], deepcopy(options))


def command_with(options: argparse.Namespace, words: Sequence[str]) -> str:
    """Return the command with further options."""
    return equivalent_command(options_with(options, words))


# --- what no option mends ----------------------------------------------------


def refuse_pairing(pairing: Mapping[str, str]) -> None:
    """Refuse points that belong to other trials."""
    pairs = [
        f"the points of {points} fit the hand of {hand}"
        for hand, points in pairing.items()
    ]
    raise DataError(
        f"the trackers' files have changed trials as it seems: {'; '.join(pairs)}. "
        "Name the files of one trial alike, such as robot_1.csv and tracker_1.csv."
    )


def refuse_flat_points(measured: Measurements) -> None:
    """Refuse points of which one coordinate never changes: that of another plane."""
    spread = np.zeros(2)
    for track in measured.tracks:
        low, high = np.quantile(track.xy, [0.05, 0.95], axis=0)
        spread = np.maximum(spread, high - low)
    flat = int(spread.argmin())
    if spread[flat] < MAX_FLAT_SHARE * spread[1 - flat]:
        axis = "xy"[flat]
        raise DataError(
            f"{axis} of the string's points never changes, by {spread[flat]:.2g} m at "
            f"most while the other coordinate changes by {spread[1 - flat]:.2g} m. "
            "It seems to be of another plane than that of the cast: name the columns "
            "of the cast's plane, as in --plane x,z, or --map tip.y=<column>."
        )


def refuse_ambiguity(
    verdict: Verdict,
    proposals: Sequence[Proposal],
    changes: Sequence[Change],
    options: argparse.Namespace,
) -> None:
    """Refuse files that several corrections make consistent, and name the commands."""
    choices = []
    for proposal, change in zip(proposals, changes, strict=True):
        command = command_with(options, change.words)
        choices.append(f"{statements_for_files(proposal)}: {command}")
    listed = "\n  ".join(choices)
    raise DataError(
        f"{describe_contradiction(verdict)}. Several corrections fit as well. Give the "
        f"one that is true:\n  {listed}"
    )


def refuse_point_inside(measured: Measurements) -> None:
    """Refuse a single point that moves as one further up the string than its tip."""
    length = measured.length
    points = {track.point for track in measured.tracks}
    if length is None or len(points) > 1 or measured.stated_arc_lengths:
        return
    (point,) = points
    best = None
    for share in np.arange(0.2, 0.96, 0.05):
        s = float(share * length)
        placed = measured.with_tracks(partial(replace, s=s))
        verdict = judge(placed)
        if best is None or (not verdict.broken and verdict.misfit < best[1].misfit):
            best = (s, verdict)
    if best is None:
        return
    s, verdict = best
    if verdict.is_consistent and verdict.is_predicted:
        raise DataError(
            f"the point '{point or 'tip'}' is no tip of a string of {length:.4g} m: it "
            f"moves as a point at {s:.3f} m. If the tip's columns are missing, add "
            f"them; if it is there, give its place: --at {point}={s:.3f}."
        )
