"""The section on the search: predicted gains, similar effects, fitted hypotheses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.report.charts.diagnosis import screening_pictures
from stringcast.stages.report.formatting import (
    effect_title,
    format_gain,
    format_mm,
    format_percent,
)
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Container,
    Details,
    Figure,
    Part,
    Section,
    TableView,
    Text,
    number_cell,
    number_cells,
)
from stringcast.stages.report.records import DiagnosisRecord

MAX_SHOWN_HYPOTHESES = 12
MIN_SHOWN_PROBABILITY = 0.05  # from which a hypothesis is always shown
SEARCH_LEAD = (
    "The search adds one cause at a time. It screens every effect of the library to "
    "first order, given the causes already found, and fits the most promising ones "
    "together with the string's parameters. The effect with the most evidence is added "
    "if it keeps enough evidence without any one of the trials. Causes that become "
    "redundant are removed."
)
NO_SEARCH_LEAD = "The misfit of the base model is too small for a search for causes."
ENTRIES_CAPTION = (
    "Causes in the order in which the search added them. Log evidence: given the "
    "causes before. By trial: rise of the log-likelihood. Residual: distance of the "
    "simulated from the measured string without and with the cause. All times and "
    "places are in iterations/*/diagnosis/entries.parquet."
)
SCREENING_CAPTION = (
    "First-order gain of the log-likelihood, with refitted string parameters. Blue: "
    "found."
)
HYPOTHESES_CAPTION = (
    "Log evidence: logarithm of the Bayes factor over the base model, averaged over "
    "the sizes of unmodelled error. Without the strongest trial: the same without the "
    "trial that supports the causes most; an effect needs enough of both. Tip shift: "
    "rms, in the trial where it is largest. Unexplained: share of the base model's "
    "mean square misfit at the tip. Probability: of the last cause against its "
    "alternatives; empty for hypotheses that were not among them."
)


def search_section(record: DiagnosisRecord) -> Section:
    """Show predicted gains, similar effects, and the hypotheses that were fitted."""
    diagnosis = record.diagnosis
    is_searched = len(diagnosis.hypotheses) > 1 or not diagnosis.screening.empty
    parts: list[Part] = [Text(SEARCH_LEAD if is_searched else NO_SEARCH_LEAD)]
    if len(diagnosis.entries):
        table = _entries_table(diagnosis.entries)
        parts.append(
            Card("Order of the causes", [table, Text(ENTRIES_CAPTION, "caption")])
        )

    figures = []
    for context, picture in screening_pictures(record):
        title = f"Predicted gains given {context or 'the base model'}"
        figures.append(Figure(title, picture, SCREENING_CAPTION))
    parts.append(Container("grid", figures))
    if len(diagnosis.likeness):
        table = _similarity_table(diagnosis.likeness)
        caption = "1: indistinguishable in these data; 0: nothing in common."
        parts.append(Card("Similar effects", [table, Text(caption, "caption")]))

    if record.document["not_tried"]:
        untried = _untried_table(record.document["not_tried"])
        parts.append(Card("Effects that were not tried", [untried]))

    # the base model first, then by evidence
    is_base = diagnosis.hypotheses["causes"] == ""
    ranked = diagnosis.hypotheses.assign(is_base=is_base).sort_values(
        ["is_base", "fit_gain"], ascending=False, kind="stable"
    )
    is_shown = ranked["probability"].to_numpy() >= MIN_SHOWN_PROBABILITY
    is_shown[:MAX_SHOWN_HYPOTHESES] = True
    shown = ranked[is_shown].to_dict("records")
    others = ranked[~is_shown].to_dict("records")
    tables: list[Part] = [_hypotheses_table(shown)]
    if others:
        tables.append(Details(f"{len(others)} more", [_hypotheses_table(others)]))
    tables.append(Text(HYPOTHESES_CAPTION, "caption"))
    parts.append(Card("Fitted hypotheses", tables))
    return Section("Search", parts)


def _untried_table(not_tried: Sequence[Mapping[str, str]]) -> TableView:
    """Tabulate the effects of the library that were not tried, and why."""
    rows = [[Cell(row["effect"], "code"), Cell(row["reason"])] for row in not_tried]
    return TableView(("effect", "reason"), rows)


def _entries_table(entries: pd.DataFrame) -> TableView:
    """Tabulate the added causes in order, with their evidence and largest effect."""
    rows = []
    for number, points in entries.groupby("number"):
        by_trial = points.groupby("trial", sort=False)["log_likelihood"].first()
        by_trial = by_trial.sort_values(ascending=False)
        trials = ", ".join(
            f"{name} {format_gain(rise)}" for name, rise in by_trial.items()
        )
        top = points.loc[(points["before"] ** 2 - points["after"] ** 2).idxmax()]
        place = (
            f"{top['trial']}, {top['t']:.2f} s, {format_mm(top['s'])} along the string"
        )
        change = f"{format_mm(top['before'], 1)} → {format_mm(top['after'], 1)}"
        evidence = number_cell(format_gain(top["evidence"]))
        cause = effect_title(top["cause"])
        rows.append([number_cell(number), cause, evidence, trials, place, change])
    columns = (
        "",
        "cause",
        "log evidence",
        "by trial",
        "largest effect",
        "residual there",
    )
    return TableView(columns, rows)


def _similarity_table(likeness: pd.DataFrame) -> TableView:
    """Tabulate the similarity of each pair of effects."""
    names = list(dict.fromkeys([*likeness["other"], *likeness["effect"]]))
    matrix = likeness.pivot(index="effect", columns="other", values="cosine")
    rows = []
    for name, cosines in matrix.loc[names[1:], names[:-1]].iterrows():
        texts = cosines.map("{:.2f}".format, na_action="ignore").fillna("")
        rows.append([effect_title(str(name)), *number_cells(texts)])
    return TableView(["", *map(effect_title, names[:-1])], rows, named=True)


def _hypotheses_table(hypotheses: Sequence[Mapping[str, Any]]) -> TableView:
    rows = []
    for row in hypotheses:
        causes = effect_title(row["causes"]) if row["causes"] else "base model alone"
        evidence = number_cell(format_gain(row["fit_gain"]))
        weakest = Cell("not evaluated", "n missing")
        if np.isfinite(row["held_out_gain"]):
            weakest = number_cell(format_gain(row["held_out_gain"]))
        shift = format_mm(row["moved"], 1)
        unexplained = format_percent(row["unexplained"])
        probability = ""
        if np.isfinite(row["probability"]):
            probability = format_percent(row["probability"])
        shares = number_cells([shift, unexplained, probability])
        rows.append([causes, evidence, weakest, *shares])
    columns = ("causes", "log evidence", "without the strongest trial", "tip shift")
    return TableView((*columns, "unexplained", "probability"), rows)
