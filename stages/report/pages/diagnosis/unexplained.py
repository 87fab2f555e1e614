"""The sections on unexplained misfit, the next experiment and string parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.charts.diagnosis import (
    proposal_picture,
    unexplained_picture,
)
from stringcast.stages.report.formatting import (
    NOT_KNOWN,
    effect_title,
    format_interval,
    format_mm,
    format_percent,
    format_value,
    join_effects,
    symbol_markup,
    unit_markup,
)
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Details,
    Figure,
    Part,
    Section,
    TableView,
    Text,
    code_text,
    number_cells,
    settings_table,
)
from stringcast.stages.report.records import DiagnosisRecord

PROPOSAL_CAPTION = Markup(
    "The string on the proposed motion, as predicted by the likeliest hypothesis, and "
    "by the others with the parameters that come closest to it within their "
    "uncertainty. Left: when they differ most. Right: largest distance along the "
    "string over time. "
    "The motion is stored in {} of this folder; {} executes it and decides."
).format(code_text("iterations/*/motion"), code_text("+experiment=decide"))


def unexplained_section(record: DiagnosisRecord) -> Section:
    """Show the unexplained misfit, the next experiment, and the extended model."""
    unexplained = record.document["unexplained"]
    texts = [unexplained[name] for name in ("sentence", "course")]
    texts.append(record.document["clocks"]["sentence"])
    parts: list[Part] = [Text(text) for text in texts if text]
    parts.append(_unexplained_part(record))
    if proposal := record.document["next_experiment"]:
        proposed: list[Part] = [Text(proposal["sentence"], "")]
        if picture := proposal_picture(record):
            proposed.append(Figure("", picture, PROPOSAL_CAPTION))
        parts.append(Card("Next experiment", proposed))
    settings = [settings_table(record.extension)]
    parts.append(Details("The extended model, as settings", settings))
    return Section("Unexplained misfit", parts, "left")


def _unexplained_part(record: DiagnosisRecord) -> Part:
    """Draw the unexplained displacement, or state how little remains."""
    if picture := unexplained_picture(record):
        table = record.diagnosis.missing
        longest = format_mm(float(np.hypot(table["x"], table["y"]).max()), 1)
        caption = (
            "A row for each trial. Each arrow is the displacement of the measured "
            "string from the model beyond noise, at its arc length s and time, in the "
            f"directions of the plane (right: +x, up: +y). The longest is {longest}; "
            "all rows have the same scale."
        )
        return Figure("Unexplained displacement", picture, caption)
    if record.is_extended or not record.diagnosis.causes.empty:
        share = format_percent(record.document["unexplained"]["fraction"])
        return Text(
            f"The extended model leaves {share} of the base model's misfit at the tip."
        )
    return Text("The unexplained misfit is below the tolerance.")


# --- parameters of the string
def parameters_section(record: DiagnosisRecord) -> Section | None:
    """Compare the string's parameters fitted without and with the causes."""
    document = record.document
    base = document["base"]["parameters"]
    extended = record.extension.get("parameter_values", {})
    sides = [(base, document["base"]), (extended, document["extended"])]
    rows = []
    for parameter in record.model.parameters:
        if parameter.name in base:
            fits = [_value_and_ends(parameter.name, *side) for side in sides]
            rows.append(_parameter_row(parameter, *fits))
    if not rows:
        return None

    pairs = []
    for pair in document["extended"]["correlations"]:
        pairs.append(f"{join_effects(pair['parameters'])} ({pair['value']:+.2f})")
    parts: list[Part] = []
    if pairs:
        words = f"Correlated parameters: {', '.join(pairs)}.".replace("-", "−")
        parts.append(Text(words, "caption"))
    lead = (
        "Each model is fitted to all trials. Differences show which parameters "
        "compensated for errors of the base model."
    )
    columns = ("parameter", "", "base model", "95 % interval", "extended model")
    table = TableView((*columns, "95 % interval", "change", "unit"), rows)
    return Section("String parameters", [Text(lead), Card("", [table, *parts])])


Fit = tuple[float | None, Sequence[float] | None]  # a value and its interval, if known


def _value_and_ends(
    name: str, values: Mapping[str, Any], certainty: Mapping[str, Any]
) -> Fit:
    value = values.get(name)
    if isinstance(value, Mapping):
        value = value["value"]
    return value, certainty["intervals"].get(name)


def _parameter_row(parameter: Parameter, base: Fit, extended: Fit) -> list[Any]:
    texts = []
    for value, ends in (base, extended):
        if value is None or ends is None:
            texts += [NOT_KNOWN if value is None else format_value(value), ""]
        else:
            shown, low, high = format_interval(value, *ends)
            texts += [shown, f"{low} to {high}"]
    cells = number_cells([*texts, _change(base[0], extended[0])])
    name = Cell(effect_title(parameter.name), title=parameter.meaning)
    return [name, symbol_markup(parameter.symbol), *cells, unit_markup(parameter.unit)]


def _change(base: float | None, extended: float | None) -> str:
    """Format a change in percent, or as a factor if it is large."""
    if extended is None or not base:
        return ""
    ratio = extended / base
    if not 1 / 3 < ratio < 3:
        return f"× {format_value(ratio)}"
    percent = round(100 * (ratio - 1))
    return f"{percent:+d} %".replace("-", "−") if percent else "0 %"
