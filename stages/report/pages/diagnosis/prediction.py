"""What is gained on trials that were left out of the fit."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from stringcast.stages.report.charts.residual import likelier, predicted
from stringcast.stages.report.formatting import gain, mm, rate
from stringcast.stages.report.page import (
    Card,
    Figure,
    Grid,
    Section,
    Table,
    Text,
    bold,
    joined,
    number,
)
from stringcast.stages.report.records import DiagnosisRecord

# times the residual without causes: that much more with them is worth a sentence
WORSE = 1.2


def gained(record: DiagnosisRecord) -> Section:
    """Base against extended model on trials that were left out of the fit."""
    title, table = (
        "What is gained on trials left out of the fit",
        record.diagnosis.held_out,
    )
    if table.empty:
        nobody = "No trial was left out of the fit, so nobody can say how well the models predict."
        return Section(title, [Text(nobody, "missing")])
    ring = (
        " The ring is the extended model fitted to all of them."
        if len(record.models) > 1 and not _aside(record)
        else ""
    )
    further = f"Each trial as predicted from the others. Further left is better; noise alone leaves the mark.{ring}"
    right = "To the right of 0 the extended model is the likelier one on a trial that neither was fitted to."
    drawn, more = (
        [Figure("Prediction of trials left out", predicted(record), further)],
        likelier(record),
    )
    drawn += [Figure("Log-likelihood gained", more, right)] if more else []
    return Section(
        title,
        [*map(Text, _prediction(record)), Grid(drawn), Card("", [_held_out(record)])],
    )


def _aside(record: DiagnosisRecord) -> bool:
    """Whether trials were set aside: left out of all fits, and of the choice of causes."""
    return not set(record.document["gain"]["held_out_trials"]) <= set(
        record.document["trials"]["used"]
    )


def _prediction(record: DiagnosisRecord) -> list[Markup | str]:
    """How the trials were predicted, and which of them worse with the causes than
    without.
    """
    total, aside = record.document["gain"], _aside(record)
    who = (
        "These trials were set aside, and predicted by"
        if aside
        else "Each trial was predicted by"
    )
    if len(record.models) == 1:
        return [
            f"There is no extended model to compare. {who} the base model after it was fitted to the others."
        ]
    chosen = "" if aside else " Which causes there are was chosen from all of them."
    rise = total["log_likelihood_per_trial"]
    error = (
        ""
        if rise["standard_error"] is None
        else f" ± {gain(rise['standard_error'])} (standard error)"
    )
    lead = f"{who} both models after they were fitted to the others.{chosen} The log-likelihood rises by "
    lead += f"{gain(rise['difference'])}{error} a trial; the matching rate E goes from "
    lead += f"{rate(total['matching_rate']['base'])} to {rate(total['matching_rate']['extended'])}."
    said: list[Markup | str] = [lead]
    for row in predicted_worse(record):
        than = f"{mm(row['rms_extended'], 1)} against {mm(row['rms_base'], 1)}"
        fitted = f"Fitted to it as well, they leave {mm(row['rms_known'], 1)}: either it alone shows something of "
        fitted += "them, as of a plane that no other reaches, or they are not right. Another trial like it would tell."
        worse = bold(
            f"{row['trial']} is predicted worse with the causes than without, {than}."
        )
        said.append(joined([worse, fitted if row["explained"] else ""]))
    return said


def predicted_worse(record: DiagnosisRecord) -> list[dict[str, Any]]:
    """Trials that are predicted worse with the causes than without; and whether these
    explain them once fitted.
    """
    if len(record.models) == 1:
        return []
    table = record.diagnosis.held_out
    worse = table[table["rms_extended"] > WORSE * table["rms_base"]]
    known = worse.get("rms_known", worse["rms_extended"])
    return worse.assign(explained=WORSE * known < worse["rms_base"]).to_dict("records")


def _held_out(record: DiagnosisRecord) -> Table:
    """A row for each trial left out, and all together."""
    sides, total = record.models, record.document["gain"]
    extended = len(sides) > 1
    columns = [
        "trial",
        *(f"RMS {side}" for side in sides),
        "noise floor",
        *(f"tip {side}" for side in sides),
    ]
    columns += [
        *(f"E {side}" for side in sides),
        *(["log-likelihood"] if extended else []),
    ]
    rows = []
    for row in record.diagnosis.held_out.to_dict("records"):
        cells = [
            *(mm(row[f"rms_{side}"], 2) for side in sides),
            mm(row["noise_floor"], 2),
        ]
        cells += [
            *(mm(row[f"tip_rms_{side}"], 2) for side in sides),
            *(rate(row[f"E_{side}"]) for side in sides),
        ]
        cells += [gain(row["log_likelihood_difference"])] if extended else []
        rows.append([row["trial"], *map(number, cells)])
    cells = [
        *(mm(total["rms_m"][side], 2) for side in sides),
        mm(total["rms_m"]["noise_floor"], 2),
    ]
    cells += [
        *(mm(total["tip_rms_m"][side], 2) for side in sides),
        *(rate(total["matching_rate"][side]) for side in sides),
    ]
    cells += [gain(total["log_likelihood_per_trial"]["difference"])] if extended else []
    return Table(columns, [*rows, [bold("all"), *map(number, cells)]])
