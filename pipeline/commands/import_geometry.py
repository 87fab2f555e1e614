"""Contradictory geometry of imported files, and the options that correct it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from stringcast.data.importers.gather import ImportedTables
from stringcast.data.schema import DataError
from stringcast.pipeline.commands.import_corrections import (
    must_confirm,
    option_words,
    states_direction,
)
from stringcast.pipeline.commands.import_options import command_with
from stringcast.pipeline.commands.imported_measurements import (
    BenchHints,
    measurements_of_tables,
)
from stringcast.stages.check.consistency.check import (
    describe_contradiction,
    describe_fit,
)
from stringcast.stages.check.consistency.corrections.directions import PointDirections
from stringcast.stages.check.consistency.judge import Verdict, judge
from stringcast.stages.check.consistency.record import Measurements
from stringcast.stages.check.consistency.search import Proposal, find_answer

MAX_FLAT_SHARE = 0.02  # range of a constant coordinate, relative to the other's
TABLE_WORDS = {
    "points": "points of the string",
    "arm": "the arm's log",
    "grasp": "hand",
    "arm, points": "the arm's log and points of the string",
}


class Change(NamedTuple):
    """Options that would resolve a contradiction in the data.

    must_ask: whether a person must confirm them. file, field: place of the fault.
    """

    reason: str
    words: list[str]
    must_ask: bool = False
    file: str = ""
    field: str = ""


def propose_geometry(
    tables: ImportedTables, bench: BenchHints, options: argparse.Namespace
) -> Change | None:
    """Return the options that make files consistent.

    Returns None if the files are consistent, or if no correction fits: then the checks
    of the dataset report the fault with a drawing. Raises DataError if several
    corrections fit, or if no option applies the correction.
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


# --- options -----------------------------------------------------------------


def change_of(
    proposal: Proposal,
    before: Verdict,
    tables: ImportedTables,
    options: argparse.Namespace,
) -> Change:
    """Return the options that apply a proposal.

    Raises DataError with another remedy if no option does.
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
        is_turned = any(isinstance(c, PointDirections) for c in corrections)
        if is_turned and states_direction(options):
            remedies = "Look at --y-down and --plane, which are given"
        raise DataError("", reason, f"{remedies}.")
    files = dict.fromkeys(table_files(c.table, tables) for c in corrections)
    fields = dict.fromkeys(correction.field for correction in corrections)
    return Change(
        reason,
        words=list(chain.from_iterable(words_of_each)),
        must_ask=any(must_confirm(c, tables) for c in corrections),
        file=", ".join(filter(None, files)),
        field=", ".join(fields),
    )


def table_files(table: str, tables: ImportedTables) -> str:
    """Return the files of a table of the dataset; empty if options give it."""
    names = []
    for column in tables.used_columns:
        is_point = column.role.endswith((".x", ".y")) or column.role == "s"
        is_hand = column.role in ("x", "y", "theta") or column.role.startswith("q")
        if (table == "points" and is_point) or (table in ("arm", "grasp") and is_hand):
            names.append(column.file.name)
    return ", ".join(dict.fromkeys(names))


def statements_for_files(proposal: Proposal) -> str:
    """Describe all faults with their places."""
    statements = []
    for correction in proposal.corrections:
        table = TABLE_WORDS.get(correction.table, "the stated geometry")
        field = correction.field.removeprefix("string.").removeprefix("arm.")
        statements.append(f"{table}, {field}: {correction.statement}")
    return " and ".join(statements)


# --- what no option mends ----------------------------------------------------


def refuse_pairing(pairing: Mapping[str, str]) -> None:
    """Refuse points that belong to other trials."""
    pairs = [
        f"the points of {points} fit the hand of {hand}"
        for hand, points in pairing.items()
    ]
    raise DataError(
        "",
        f"the trackers' files have changed trials as it seems: {'; '.join(pairs)}",
        "Name the files of one trial alike, such as robot_1.csv and tracker_1.csv.",
    )


def refuse_flat_points(measured: Measurements) -> None:
    """Refuse points with a constant coordinate, which belongs to another plane."""
    spread = np.zeros(2)
    for track in measured.tracks:
        low, high = np.quantile(track.xy, [0.05, 0.95], axis=0)
        spread = np.maximum(spread, high - low)
    flat = int(spread.argmin())
    if spread[flat] < MAX_FLAT_SHARE * spread[1 - flat]:
        axis = "xy"[flat]
        raise DataError(
            "",
            f"{axis} of the string's points never changes, by {spread[flat]:.2g} "
            "m at most while the other coordinate changes by "
            f"{spread[1 - flat]:.2g} m",
            "It seems to be of another plane than that of the cast: name the "
            "columns of the cast's plane, as in --plane x,z, or --map "
            "tip.y=<column>.",
        )


def refuse_ambiguity(
    verdict: Verdict,
    proposals: Sequence[Proposal],
    changes: Sequence[Change],
    options: argparse.Namespace,
) -> None:
    """Refuse files that several corrections make consistent; name the commands."""
    choices = []
    for proposal, change in zip(proposals, changes, strict=True):
        command = command_with(options, change.words)
        choices.append(f"{statements_for_files(proposal)}: {command}")
    listed = "\n  ".join(choices)
    raise DataError(
        "",
        describe_contradiction(verdict),
        f"Several corrections fit as well. Give the one that is true:\n  {listed}",
    )


def refuse_point_inside(measured: Measurements) -> None:
    """Refuse a single point that moves like a point above the tip."""
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
            "",
            f"the point '{point or 'tip'}' is no tip of a string of {length:.4g} "
            f"m: it moves as a point at {s:.3f} m",
            "If the tip's columns are missing, add them; if it is there, give "
            f"its place: --at {point}={s:.3f}.",
        )
