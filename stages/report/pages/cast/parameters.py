"""The section of the estimated parameters of the string."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from stringcast.data.estimates import Estimate
from stringcast.stages.common import readable_name
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.charts.cast import history_picture
from stringcast.stages.report.formatting import (
    NOT_KNOWN,
    format_interval,
    format_value,
    sentence_markup,
    symbol_markup,
    unit_markup,
)
from stringcast.stages.report.pages.cast.shared_parts import matching_part
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Container,
    Explore,
    Key,
    Part,
    Section,
    Small,
    TableView,
    Text,
    bold_text,
    number_cells,
)
from stringcast.stages.report.records import RunRecord

HISTORY_KEY = (
    ("best value; 0 is the start value", "var(--after)"),
    ("● determined", "none"),
    ("○ not determined by the data, or unknown", "none"),
    ("searched range", "band"),
    ("95 % interval, if the method gives one", "bar"),
)


def parameters_section(record: RunRecord) -> Section:
    """Show each parameter of the last estimate; without casts also E over time."""
    title = "Parameters of the string"
    if not record.estimates:
        return Section(title, [Text("Nothing was estimated in this run.", "missing")])
    estimate = record.estimates[-1]
    rows = estimate.parameters.set_index("name")
    model = extend_model(record.model, rows.index)
    parameters = [p for p in model.parameters if p.name in rows.index]
    parts: list[Part] = [Text(sentence_markup(estimate.fit["sentence"].iloc[0]))]
    if len(record.estimates) > 1:
        pictures = []
        for parameter in parameters:
            name = bold_text(readable_name(parameter.name))
            caption = Markup("{} {} <span>[{}]</span>").format(
                symbol_markup(parameter.symbol), name, unit_markup(parameter.unit)
            )
            pictures.append((caption, history_picture(parameter, record.estimates)))
        parts.append(Card("", [Key(HISTORY_KEY), Small(pictures)]))
    parts.append(Card("", [parameter_table(model, estimate)]))
    if not record.casts:
        charts = []
        for number, estimate in enumerate(record.estimates, start=1):
            chart_title = f"Matching rate over time, estimation {number}"
            charts.append(matching_part(estimate, title=chart_title))
        parts.append(Explore([Container("grid", charts)]))
    return Section(title, parts)


def parameter_table(model: Model, estimate: Estimate) -> TableView:
    """Tabulate the estimates of a model's parameters."""
    columns = ("parameter", "", "value", "95 % interval", "searched range", "unit")
    rows = estimate.parameters.set_index("name")
    table = [
        _parameter_row(parameter, rows.loc[parameter.name])
        for parameter in model.parameters
        if parameter.name in rows.index
    ]
    return TableView([*columns, "determined by the data"], table)


def _parameter_row(parameter: Parameter, row: pd.Series) -> list[Any]:
    """Format the estimate of a parameter, and whether the data determine it."""
    value, low, high = format_interval(row["value"], row["low"], row["high"])
    interval = "none" if NOT_KNOWN in (low, high) else f"{low} to {high}"
    determined = "no" if np.isfinite(row["low"]) else NOT_KNOWN
    if row["determined"]:
        determined = "yes"
    if row["at_bound"]:
        determined += ", at the end of its range"
    searched = f"{format_value(row['minimum'])} to {format_value(row['maximum'])}"
    return [
        Cell(readable_name(parameter.name), title=parameter.meaning),
        symbol_markup(parameter.symbol),
        *number_cells([value, interval, searched]),
        unit_markup(parameter.unit),
        determined,
    ]
