"""The page of a check: what was measured, drawn trial by trial, and what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib import style

from stringcast.stages.check.measured import CheckedDataset, CheckedTrial
from stringcast.stages.check.overview import DETECTION_NOTE, detection_limit_text
from stringcast.stages.report.charts.measured import trial_figures, trial_words
from stringcast.stages.report.formatting import mm
from stringcast.stages.report.page import (
    Card,
    Cell,
    Figure,
    Grid,
    Page,
    Part,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    number,
)
from stringcast.stages.report.theme import STYLE_SHEET, vector

DRAWN = 10  # trials: 130 kB each, so that a page stays below 1.5 MB
CAPTION = (
    "Arm and string as they began, and fainter later: the string shall begin in the hand and hang from it. Over time: "
    "where hand and tip are, and how fast: they shall begin to move together."
)


def check_page(
    measured: CheckedDataset,
    found: Mapping[str, Any],
    origin: Mapping[str, Any],
    following: Sequence[tuple[str, str]],
) -> str:
    """The page as text. found: as `check.overview` says it. following: what can be done
    next, and the command.
    """
    usable = found["usable"]
    errors = sum(finding["severity"] == "error" for finding in found["findings"])
    count = len(found["findings"])
    heading = (
        "These trials can be used"
        if usable
        else "These trials cannot be used as they are"
    )
    trials = list(measured.with_points())
    sections: list[Part] = [
        Tiles(
            [
                Tile(str(len(found["trials"])), "trials that can be read"),
                Tile(
                    mm(measured.length),
                    "length of the string, from the grasp to the tip",
                ),
                Tile(
                    str(count),
                    f"finding{'s' * (count != 1)}, {errors or 'no'} error{'s' * (errors != 1)} among them",
                ),
            ]
        ),
        Section("What was found", [findings(found["findings"])]),
        Section("Trial by trial", [Card("", [overview(found["trials"])])]),
        *told(found.get("effects", [])),
        Section("What was measured", [Text(CAPTION), *drawn(trials[:DRAWN])]),
    ]
    if len(trials) > DRAWN:
        sections.append(Text(f"{len(trials) - DRAWN} more trials are not drawn."))
    name = measured.data.folder.name
    lead = f"Measured data in {found['folder']}: what is there, what looks wrong, and what to do."
    tone = "good" if usable else "bad"
    title = f"{name}: {heading.lower()}"
    words = (title, f"stringcast check · {name}", heading, lead)
    return str(
        Page(*words, sections, origin, {}, tone, marked=True, following=following)
    )


def drawn(trials: Sequence[CheckedTrial]) -> list[Part]:
    """Trials as they were measured, each in the plane and over time."""
    clocks = "Each on its own clock; dotted: when it begins to move."
    grids: list[Part] = []
    with style.context(STYLE_SHEET):
        for seen in trials:
            said, title = (
                trial_words(seen),
                f"Trial {seen.name}: hand and tip over time",
            )
            plane, times = trial_figures(seen)
            beside = Figure(title, vector(times, title), clocks)
            grids.append(
                Grid([Figure(f"Trial {seen.name}", vector(plane, said), said), beside])
            )
    return grids


def findings(found: Sequence[Mapping[str, Any]]) -> Part:
    """A row for each, the worst first."""
    rows = [
        [
            one["severity"],
            Cell(" ".join(filter(None, (one["file"], one["field"]))), "code"),
            ", ".join(one["trials"]) or "all",
            one["statement"],
            one["remedy"],
        ]
        for one in found
    ]
    columns = ("how sure", "where", "trials", "what is so", "what to do")
    return Card("", [Table(columns, rows) if rows else Text("Nothing looks wrong.")])


def told(effects: Sequence[Mapping[str, Any]]) -> list[Part]:
    """What trials could tell of each effect; nothing where it was not asked."""
    columns = [
        "effect",
        "what it is",
        "found from",
        "then at the tip [mm]",
        "like the string [%]",
        "taken for",
    ]
    rows = [
        [
            Cell(f"{one['effect']}.{one['parameter']}", "code"),
            one["meaning"],
            number(detection_limit_text(one)),
            number("" if one["tip_m"] is None else f"{1e3 * one['tip_m']:.1f}"),
            number(f"{100 * one['imitated']:.0f}"),
            ", ".join(one["alike"]),
        ]
        for one in effects
    ]
    return (
        [
            Section(
                "What these trials can tell",
                [Text(DETECTION_NOTE), Card("", [Table(columns, rows)])],
            )
        ]
        if rows
        else []
    )


def overview(trials: Sequence[Mapping[str, Any]]) -> Table:
    """A row for each trial that can be read."""
    columns = [
        "trial",
        "seen [s]",
        "with arm [s]",
        "frames",
        "frames [1/s]",
        "arm [1/s]",
        "points a frame",
    ]
    columns += ["noise [mm]", "way of the hand [m]", "begins"]
    rows = []
    for one in trials:
        noise = "" if one["noise"] is None else f"{1e3 * one['noise']:.2f}"
        rates = [
            "" if one[name] is None else f"{one[name]:.0f}"
            for name in ("fps", "hand_rate")
        ]
        times = [f"{one[name]:.2f}" for name in ("duration", "common")]
        numbers = [
            *times,
            one["frames"],
            *rates,
            f"{one['points']:.0f}",
            noise,
            f"{one['path']:.2f}",
        ]
        rows.append([one["trial"], *map(number, numbers), one["begins"]])
    return Table(columns, rows)
