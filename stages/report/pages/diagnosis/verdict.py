"""The verdict: tiles, rejected trials, causes, alternatives and error budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from stringcast.stages.model.library import effects_by_name
from stringcast.stages.report.charts.diagnosis import law_picture
from stringcast.stages.report.formatting import (
    effect_title,
    format_count,
    format_gain,
    format_mm,
    format_percent,
    format_quantity,
    join_effects,
    join_names,
)
from stringcast.stages.report.pages.diagnosis.held_out import worse_predictions
from stringcast.stages.report.parts import (
    Card,
    Container,
    Figure,
    Part,
    Section,
    TableView,
    Text,
    Tiles,
    bold_text,
    link,
    name_value_table,
    number_cell,
    number_cells,
    table_card,
)
from stringcast.stages.report.records import DiagnosisRecord

MIN_ALTERNATIVE_PROBABILITY = 0.01
LIKELY_PROBABILITY = 0.5


def verdict_tiles(record: DiagnosisRecord) -> Tiles:
    """Show the number of used trials, and the prediction errors of the models."""
    trials, gain = record.document["trials"], record.document["gain"]
    used, outliers = len(trials["used"]), trials["points_left_out"]["outliers"]
    data = [f"trial{'s' * (used != 1)} used"]
    if trials["rejected"]:
        data.append(f"{len(trials['rejected'])} rejected")
    if outliers:
        data.append(f"{format_count(outliers, 'outlier')} excluded")
    length = format_mm(record.model.string.length)
    first = (str(used), f"{', '.join(data)}; string of {length}")
    if not gain["held_out_trials"]:
        return Tiles(
            [first, ("not known", "prediction: no trial could be left out of the fit")]
        )

    which = "base and extended model" if record.is_extended else "base model"
    if worse := [row["trial"] for row in worse_predictions(record)]:
        which += f" (worse for {join_names(worse)}: see below)"
    noise = format_mm(gain["rms_m"]["noise_floor"], 1)
    sizes = []
    for quantity in ("rms_m", "tip_rms_m"):
        values = [format_mm(gain[quantity][model], 1) for model in record.models]
        sizes.append(" → ".join(values))
    meaning = f"rms residual on held-out trials, {which}; noise alone: {noise}"
    tip = "the same at the tip, or the outermost point measured"
    return Tiles([first, (sizes[0], meaning), (sizes[1], tip)])


def rejected_card(record: DiagnosisRecord) -> Part | None:
    """List trials that could not be used, and why."""
    rejected = list(record.document["trials"]["rejected"].items())
    if not rejected:
        return None
    return Card("Rejected trials", [name_value_table(rejected)])


def causes_section(record: DiagnosisRecord) -> Section:
    """Show the causes with their parameters and laws, and the alternatives."""
    groups = record.diagnosis.causes.groupby("effect", sort=False)
    undecided = {
        name for group in record.document["indistinguishable"] for name in group
    }
    cards = [
        _cause_card(str(name), rows, name not in undecided) for name, rows in groups
    ]
    parts: list[Part] = [Text(words) for words in _explain_verdict(record)]
    if cards:
        parts.append(Container("grid", cards))
    rows = []
    for other in record.document["alternatives"]:
        if other["probability"] > MIN_ALTERNATIVE_PROBABILITY:
            probability = number_cell(format_percent(other["probability"]))
            rows.append((_alternative_title(record, other["effect"]), probability))
    alternatives: Part = Text("None above 1 %.", "missing")
    if rows:
        alternatives = name_value_table(rows)
    parts.append(Card("Alternatives", [alternatives]))
    set_aside = []
    for other in record.document["set_aside"]:
        set_aside.append((effect_title(other["effect"]), other["reason"]))
    if set_aside:
        parts.append(Card("Excluded causes", [name_value_table(set_aside)]))
    return Section("Causes" if cards else "No cause found", parts)


def _alternative_title(record: DiagnosisRecord, name: str) -> str:
    """Name an alternative; an unknown cause acts in addition to named causes."""
    title = effect_title(name)
    is_addition = name == "unknown" and record.document["causes"]
    return f"in addition, {title}" if is_addition else title


def _cause_card(name: str, rows: pd.DataFrame, is_decided: bool) -> Card:
    """Show a cause with the values and the law of its effect.

    is_decided: whether the data distinguish it from all other causes.
    """
    sentence = str(rows["sentence"].iloc[0])
    parts: list[Part] = [Text(f"{sentence[:1].upper()}{sentence[1:]}.", "")]
    parameters = rows[rows["parameter"] != ""]
    values = {}
    table = []
    for row in parameters.to_dict("records"):
        values[row["parameter"].rpartition(".")[2]] = row["value"]
        table.append((row["meaning"], *number_cells(format_quantity(row))))
    if table:
        parts.append(TableView(("", "value", "95 % interval"), table))
    effect = effects_by_name()[name]
    reference = f"Reference: {effect.reference}." if effect.reference else ""
    parts.append(Figure("", law_picture(effect, values), reference))
    probability = rows["probability"].iloc[0]
    is_likely = is_decided and probability > LIKELY_PROBABILITY
    tone = "good" if is_likely else ""
    title = Markup('{} <span class="badge {}">{}</span>')
    return Card(
        title.format(effect_title(name), tone, format_percent(probability)), parts
    )


def _explain_verdict(record: DiagnosisRecord) -> list[Markup | str]:
    """Explain the verdict in sentences."""
    document = record.document
    sentences = [
        _explain_group(record, group) for group in document["indistinguishable"]
    ]
    if document["interrupted"]:
        sentences.append("No cause is named, because the search is incomplete.")
    else:
        sentences += VERDICT_TEXTS.get(document["verdict"], [])
    return sentences


VERDICT_TEXTS: dict[str, list[Markup | str]] = {
    "none": ["The misfit is noise and below the tolerance. No effect is evident."],
    "partial": [
        Markup(
            "These causes act, but they do not explain all of the misfit: more than "
            "the tolerance remains at the tip. See {}."
        ).format(link("#left", "Unexplained misfit"))
    ],
    "unknown": [
        Markup(
            "The misfit at the tip exceeds the tolerance, and no effects of the "
            "library remove enough of it. See {}."
        ).format(link("#left", "Unexplained misfit"))
    ],
    "insufficient": ["Naming a cause requires more data. Partial results follow."],
}


def _explain_group(record: DiagnosisRecord, group: Sequence[str]) -> Markup | str:
    """State that the data do not distinguish a group of causes."""
    table = record.diagnosis.likeness
    cosines = table.loc[
        table["effect"].isin(group) & table["other"].isin(group), "cosine"
    ]
    least = f" (correlation {cosines.min():.3f})" if len(cosines) else ""
    names = bold_text(f"These data do not distinguish {join_effects(group)}{least}.")
    return names + (
        " Each explains the measurements about equally well. They share the "
        "probabilities below."
    )


def budget_section(record: DiagnosisRecord) -> Section | None:
    """Show the error budget at the tip, if the diagnosis has one."""
    sources, misfit = record.document["budget"], record.document["unexplained"]
    if not sources:
        return None
    size = {end: format_mm(value, 1) for end, value in misfit["tip_rms_m"].items()}
    tolerance = format_mm(misfit["tolerance_m"], 1)
    lead = (
        "Shift of the string's tip by each source, rms over the trials. "
        f"Unexplained: {size['value']} ({size['low']} to {size['high']}, 95 %); "
        f"tolerance: {tolerance}."
    )
    rows = [_budget_row(source) for source in sources]
    table = table_card(("source", "at the tip", "log evidence"), rows)
    return Section("Error budget", [Text(lead), table])


def _budget_row(source: Mapping[str, Any]) -> list[Any]:
    evidence = format_gain(source.get("log_evidence", np.nan), "")
    texts = [format_mm(source["tip_rms_m"], 2), evidence]
    return [effect_title(source["source"]), *number_cells(texts)]
