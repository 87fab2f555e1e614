"""The page of a check: findings about measured data, and the data trial by trial."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import pandas as pd

from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.check.overview import (
    DETECTION_NOTE,
    effect_table,
    trial_table,
)
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

    found: result of `dataset_overview`. origin: code and files. following: purposes and
    commands to continue with.
    """
    findings = found["findings"]
    error_count = sum(finding["severity"] == "error" for finding in findings)
    errors = format_count(error_count, "error")
    tiles = [
        (str(len(found["trials"])), "readable trials"),
        (format_mm(measured.length), "length of the string, from the grasp to the tip"),
        (str(len(findings)), f"findings, of which {errors}"),
    ]
    trials_seen = trial_table(found["trials"])
    sections: list[Part] = [
        Tiles(tiles),
        Section("Findings", [_findings_card(findings)]),
        Section("Trials", [_numbers_card(trials_seen, {"trial", "begins"})]),
    ]
    if effects := found.get("effects"):
        names = {"effect", "meaning", "mistaken for"}
        parts = [Text(DETECTION_NOTE), _numbers_card(effect_table(effects), names)]
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


def _numbers_card(table: pd.DataFrame, words: Collection[str]) -> Card:
    """Show a table of texts; columns other than `words` hold numbers."""
    rows = []
    for row in table.to_dict("records"):
        cells = []
        for name, text in row.items():
            cells.append(text if name in words else number_cell(text))
        rows.append(cells)
    return table_card(list(table), rows)
