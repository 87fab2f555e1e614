"""The page of a check: findings about measured data, and the data trial by trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.check.overview import DETECTION_NOTE, detection_limit_text
from stringcast.stages.report.charts.trial import describe_trial, trial_figure
from stringcast.stages.report.formatting import format_count, format_mm
from stringcast.stages.report.page import Page
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Container,
    Figure,
    Part,
    Section,
    Text,
    Tiles,
    number_cell,
    number_cells,
    table_card,
)
from stringcast.stages.report.theme import svg_picture

MAX_DRAWN_TRIALS = 10  # 130 kB each, so that a page stays below 1.5 MB
TRIALS_LEAD = (
    "Top: arm and string at the start, and fainter later; the string must begin in "
    "the hand and hang from it. Below: positions and speeds of hand and tip, each on "
    "its own clock; the tip must begin to move with the hand or soon after (dotted)."
)


def check_page(
    measured: CheckedDataset,
    found: Mapping[str, Any],
    origin: Mapping[str, Any],
    following: Sequence[tuple[str, str]],
) -> str:
    """Render the page of a check of measured data.

    Parameters
    ----------
    measured : CheckedDataset
    found : mapping
        Result of `check.overview`.
    origin : mapping
        Code and files.
    following : sequence of (purpose, command)
        Commands to continue with.
    """
    findings = found["findings"]
    error_count = sum(finding["severity"] == "error" for finding in findings)
    errors = format_count(error_count, "error")
    tiles = [
        (str(len(found["trials"])), "readable trials"),
        (format_mm(measured.length), "length of the string, from the grasp to the tip"),
        (str(len(findings)), f"findings, of which {errors}"),
    ]
    sections: list[Part] = [
        Tiles(tiles),
        Section("Findings", [_findings_card(findings)]),
        Section("Trials", [_trials_card(found["trials"])]),
    ]
    if effects := found.get("effects"):
        parts = [Text(DETECTION_NOTE), _effects_card(effects)]
        sections.append(Section("Detectable effects", parts))
    trials = list(measured.with_points())
    figures = []
    for trial in trials[:MAX_DRAWN_TRIALS]:
        words = describe_trial(trial)
        picture = svg_picture(trial_figure(trial), words)
        figures.append(Figure(f"Trial {trial.name}", picture, words))
    grid = Container("grid", figures)
    sections.append(Section("Measurements", [Text(TRIALS_LEAD), grid]))
    more = len(trials) - MAX_DRAWN_TRIALS
    if more > 0:
        sections.append(Text(f"{more} more trials are not drawn."))
    usable = found["usable"]
    page = Page(
        kind="check",
        name=measured.data.folder.name,
        heading=f"These trials are {'usable' if usable else 'not usable yet'}",
        lead=f"Measured data in {found['folder']}: contents, findings and remedies.",
        sections=sections,
        origin=origin,
        settings={},
        tone="good" if usable else "bad",
        following=following,
    )
    return str(page)


def _findings_card(findings: Sequence[Mapping[str, Any]]) -> Part:
    """List the findings, the worst first."""
    if not findings:
        return Card("", [Text("No problems were found.")])
    rows = []
    for finding in findings:
        place = " ".join(filter(None, (finding["file"], finding["field"])))
        trials = ", ".join(finding["trials"]) or "all"
        what = (finding["statement"], finding["remedy"])
        rows.append([finding["severity"], Cell(place, "code"), trials, *what])
    columns = ("severity", "where", "trials", "finding", "remedy")
    return table_card(columns, rows)


def _effects_card(effects: Sequence[Mapping[str, Any]]) -> Card:
    """List the smallest size at which these trials would show each effect."""
    columns = ["effect", "meaning", "detectable from", "shift of the tip [mm]"]
    columns += ["imitated by the string [%]", "mistaken for"]
    rows = []
    for effect in effects:
        tip = "" if effect["tip_m"] is None else f"{1e3 * effect['tip_m']:.1f}"
        rows.append(
            [
                Cell(f"{effect['effect']}.{effect['parameter']}", "code"),
                effect["meaning"],
                number_cell(detection_limit_text(effect)),
                number_cell(tip),
                number_cell(f"{100 * effect['imitated']:.0f}"),
                ", ".join(effect["alike"]),
            ]
        )
    return table_card(columns, rows)


TRIAL_COLUMNS = {
    "filmed [s]": ("duration", ".2f"),
    "filmed with arm [s]": ("common", ".2f"),
    "frames": ("frames", "d"),
    "frames [1/s]": ("fps", ".0f"),
    "arm [1/s]": ("hand_rate", ".0f"),
    "points a frame": ("points", ".0f"),
    "noise [mm]": ("noise_mm", ".2f"),
    "hand path [m]": ("path", ".2f"),
}


def _trials_card(trials: Sequence[Mapping[str, Any]]) -> Card:
    """List the readable trials."""
    rows = []
    for trial in trials:
        noise = trial["noise"]
        values = {**trial, "noise_mm": None if noise is None else 1e3 * noise}
        texts = []
        for name, spec in TRIAL_COLUMNS.values():
            texts.append("" if values[name] is None else format(values[name], spec))
        rows.append([trial["trial"], *number_cells(texts), trial["begins"]])
    return table_card(["trial", *TRIAL_COLUMNS, "start"], rows)
