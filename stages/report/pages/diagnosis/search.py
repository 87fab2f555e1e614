"""How it was found: promised effects, look-alikes, and every hypothesis that was
fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.stages.report.charts.parameters import likeness, screenings
from stringcast.stages.report.formatting import gain, mm, percent, plain
from stringcast.stages.report.page import (
    Card,
    Cell,
    Details,
    Figure,
    Grid,
    Part,
    Section,
    Table,
    Text,
    number,
)
from stringcast.stages.report.records import DiagnosisRecord

SEARCH = (
    "One cause after another: beside those already in the model every effect of the library is tried to first "
    "order, the most promising are fitted together with the string's parameters, and the one with most evidence "
    "enters if it has enough of it whichever trial is left out. What the others make needless leaves again."
)
NO_SEARCH = "The base model left nothing that was worth a search for causes."
WAY = (
    "Of the causes that the search found, named or not, as they entered. Log evidence: beside those before, all that "
    "is known in the end taken into account. Of each trial: by how much the cause raises its log-likelihood. Off: how "
    "far the simulated string lies from the measured one without the cause and with it. All moments and places are in "
    "table `entries`."
)
FEW = 12  # theories shown at once; the others are folded
EVIDENCE = (
    "Log evidence: logarithm of the Bayes factor over the base model, all sizes of what the model may lack taken into "
    "account. Without the strongest trial: the same without the trial that says most for the causes; an effect enters "
    "only with enough of both. Tip moved: by these causes, root mean square, in the trial where it is most. Left "
    "unexplained: of what the base model lacks at the tip, in mean square. Probability: of the last cause in its "
    "place, the others staying."
)


def found(record: DiagnosisRecord) -> Section:
    """The section of promised effects, look-alikes, and every hypothesis that was
    fitted.
    """
    first = "Gain of the log-likelihood to first order, with the string's parameters refitted. Blue: named as a cause."
    drawn = []
    for context, picture in screenings(record):
        drawn.append(
            Figure(
                f"Predicted gains {f'beside {context}' if context else 'of all effects'}",
                picture,
                first,
            )
        )
    alike = likeness(record)
    if alike:
        about = "1: the two do the same to this data and cannot be told apart; 0: nothing in common."
        drawn.append(Figure("Confounded effects", alike, about))

    # the hypotheses with the least cost first; the base model is among the few that are
    # shown
    rows = record.diagnosis.hypotheses.sort_values(
        "fit_gain", ascending=False, kind="stable"
    ).reset_index(drop=True)
    late = (rows["causes"] == "") & (np.arange(len(rows)) >= FEW)
    order = np.where(late, FEW - 1.5, np.arange(len(rows)))
    theories = rows.iloc[np.argsort(order, kind="stable")].to_dict("records")
    more = theories[FEW:]
    tried: list[Part] = [_theories_table(theories[:FEW])]
    tried += [Details(f"{len(more)} more", [_theories_table(more)])] if more else []
    searched = (
        len(record.diagnosis.hypotheses) > 1 or not record.diagnosis.screening.empty
    )
    fitted = Card("Hypotheses fitted", [*tried, Text(EVIDENCE, "caption")])
    entries = record.diagnosis.entries
    way = (
        [Card("Path of entry", [_way(entries), Text(WAY, "caption")])]
        if len(entries)
        else []
    )
    return Section(
        "How it was found",
        [Text(SEARCH if searched else NO_SEARCH), *way, Grid(drawn), fitted],
    )


def _way(entries: pd.DataFrame) -> Table:
    """Which cause entered when, by what evidence, in which trials, and where it
    explains most.
    """
    rows = []
    for order, own in entries.groupby("number"):
        rises = (
            own.groupby("trial", sort=False)["log_likelihood"]
            .first()
            .sort_values(ascending=False)
        )
        most = own.loc[(own["before"] ** 2 - own["after"] ** 2).idxmax()]
        place = f"{most['trial']}, {most['t']:.2f} s, {mm(most['s'])} along the string"
        moved = f"{mm(most['before'], 1)} → {mm(most['after'], 1)}"
        trials = ", ".join(f"{name} {gain(rise)}" for name, rise in rises.items())
        rows.append(
            [
                number(order),
                plain(most["cause"]),
                number(gain(most["evidence"])),
                trials,
                place,
                moved,
            ]
        )
    return Table(
        ("", "cause", "log evidence", "of each trial", "explains most in", "off there"),
        rows,
    )


def _theories_table(theories: Sequence[Mapping[str, Any]]) -> Table:
    columns = (
        "causes",
        "log evidence",
        "without the strongest trial",
        "tip moved",
        "left unexplained",
    )
    rows = []
    for row in theories:
        held_out = row["held_out_gain"]
        weakest = (
            number(gain(held_out))
            if np.isfinite(held_out)
            else Cell("not evaluated", "n missing")
        )
        shares = (
            number(mm(row["moved"], 1)),
            number(percent(row["unexplained"])),
            number(percent(row["probability"])),
        )
        causes = plain(row["causes"]) if row["causes"] else "base model alone"
        rows.append([causes, number(gain(row["fit_gain"])), weakest, *shares])
    return Table((*columns, "probability"), rows)
