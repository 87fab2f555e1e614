"""The section on the prediction of held-out trials."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from stringcast.stages.report.formatting import format_gain, format_mm, format_rate
from stringcast.stages.report.parts import (
    Card,
    Section,
    TableView,
    Text,
    bold_text,
    join_sentences,
    number_cells,
)
from stringcast.stages.report.records import DiagnosisRecord

WORSE_FACTOR = 1.2  # residual with causes over that without, to be reported


def held_out_section(record: DiagnosisRecord) -> Section:
    """Compare base and extended model on trials that were left out of the fit."""
    title = "Prediction of held-out trials"
    if record.diagnosis.held_out.empty:
        reason = "No trial was left out of the fit, so the predictions were not tested."
        return Section(title, [Text(reason, "missing")])
    table = Card("", [_held_out_table(record)])
    texts = [Text(words) for words in _describe_prediction(record)]
    return Section(title, [*texts, table])


def _describe_prediction(record: DiagnosisRecord) -> list[Markup | str]:
    """Describe how the trials were predicted, and which are worse with the causes."""
    gain = record.document["gain"]
    excluded = record.has_excluded_trials
    trials = "These trials were excluded from the search" if excluded else "Each trial"
    was = "and predicted by" if excluded else "was predicted by"
    if not record.is_extended:
        return [
            f"No model was extended. {trials} {was} the base model fitted to the "
            "others."
        ]
    lead = f"{trials} {was} both models fitted to the others."
    if not excluded:
        lead += " The causes were chosen from all trials."
    change = gain["log_likelihood_per_trial"]
    rise = format_gain(change["difference"])
    if change["standard_error"] is not None:
        rise += f" ± {format_gain(change['standard_error'])} (standard error)"
    rates = gain["matching_rate"]
    lead += (
        f" The log-likelihood rises by {rise} per trial; the matching rate E changes "
        f"from {format_rate(rates['base'])} to {format_rate(rates['extended'])}."
    )
    sentences: list[Markup | str] = [lead]
    for row in worse_predictions(record):
        sizes = (
            f"{format_mm(row['rms_extended'], 1)} against "
            f"{format_mm(row['rms_base'], 1)}"
        )
        worse = (
            f"{row['trial']} is predicted worse with the causes than without, {sizes}."
        )
        reason = ""
        if WORSE_FACTOR * row["rms_known"] < row["rms_base"]:
            reason = (
                f"After fitting it as well, {format_mm(row['rms_known'], 1)} remain. "
                "Either only this trial shows some of the causes, or the causes are "
                "wrong. A similar trial would distinguish the two."
            )
        sentences.append(join_sentences([bold_text(worse), reason]))
    return sentences


def worse_predictions(record: DiagnosisRecord) -> list[dict[str, Any]]:
    """Return rows of trials that the base model predicts better."""
    if not record.is_extended:
        return []
    table = record.diagnosis.held_out
    is_worse = table["rms_extended"] > WORSE_FACTOR * table["rms_base"]
    return table[is_worse].to_dict("records")


def _held_out_table(record: DiagnosisRecord) -> TableView:
    """Tabulate each held-out trial, and all together."""
    gain = record.document["gain"]
    total: dict[str, Any] = {
        "trial": bold_text("all"),
        "noise_floor": gain["rms_m"]["noise_floor"],
        "log_likelihood_difference": gain["log_likelihood_per_trial"]["difference"],
    }
    rms, tip, rates = {}, {}, {}  # columns of the table by their titles
    for model in record.models:
        total[f"rms_{model}"] = gain["rms_m"][model]
        total[f"tip_rms_{model}"] = gain["tip_rms_m"][model]
        total[f"E_{model}"] = gain["matching_rate"][model]
        rms[f"RMS {model}"] = f"rms_{model}"
        tip[f"tip {model}"] = f"tip_rms_{model}"
        rates[f"E {model}"] = f"E_{model}"
    lengths = rms | {"noise floor": "noise_floor"} | tip
    gains = (
        {"log-likelihood": "log_likelihood_difference"} if record.is_extended else {}
    )

    rows = []
    for row in (*record.diagnosis.held_out.to_dict("records"), total):
        texts = [format_mm(row[name], 2) for name in lengths.values()]
        texts += [format_rate(row[name]) for name in rates.values()]
        texts += [format_gain(row[name]) for name in gains.values()]
        rows.append([row["trial"], *number_cells(texts)])
    return TableView(["trial", *lengths, *rates, *gains], rows)
