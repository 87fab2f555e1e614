"""What is left: a missing force, what to try next, and the string with the model to go
on with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.charts.string import proposed
from stringcast.stages.report.charts.time import missing
from stringcast.stages.report.formatting import (
    UNKNOWN,
    mm,
    percent,
    plain,
    significant,
    symbol,
    unit,
    within,
)
from stringcast.stages.report.page import (
    Card,
    Cell,
    Details,
    Figure,
    Part,
    Section,
    Table,
    Text,
    code,
    named,
    number,
)
from stringcast.stages.report.records import DiagnosisRecord


def left(record: DiagnosisRecord) -> Section:
    """The section of the missing force, of what to try next, and of the model to go on
    with.
    """
    said, following = (
        record.document["unexplained"]["sentence"],
        record.document["next_experiment"],
    )
    parts: list[Part] = [Text(said)] if said else []
    parts.append(_left_over(record))
    if following:
        told: list[Part] = [Text(following["sentence"], "")]
        if drawn := proposed(record):
            about = Markup(
                "The string on the motion proposed: as the likeliest theory has it, and as near to that as the others "
                "can come by moving their own parameters within what these trials allow. Left: where they are farthest "
                "apart. Right: over time, anywhere on the string. The motion is kept beside this page as {}; {} "
                "performs it and concludes."
            ).format(code("iterations/*/motion"), code("+experiment=decide"))
            told.append(Figure("", drawn, about))
        parts.append(Card("What to try next", told))
    extension = Details("The extended model, as settings", [named(record.extension)])
    return Section("What is left", [*parts, extension], "left")


def _left_over(record: DiagnosisRecord) -> Part:
    """A picture of what nothing explains, or why there is none."""
    drawn, table = missing(record), record.diagnosis.missing
    if drawn:
        most = mm(float(np.hypot(table["x"], table["y"]).max()), 1)
        about = (
            "A row for each trial. Each arrow is how far the measured string lies from the model at its place s and "
            f"time, beyond noise, pointing as in the plane (right: +x, up: +y). The longest is {most}. Equally long "
            "arrows are equally much in all rows."
        )
        return Figure("What nothing explains", drawn, about)
    if len(record.models) > 1 or not record.diagnosis.causes.empty:
        share = percent(record.document["unexplained"]["fraction"])
        return Text(
            f"The extended model leaves {share} of what the base model lacks at the tip."
        )
    return Text("Less is left than is tolerated.")


def string(record: DiagnosisRecord) -> Section | None:
    """The string's parameters, fitted without and with the causes."""
    base, known = (
        record.document["base"]["parameters"],
        record.extension.get("known", {}),
    )
    value = {
        name: each["value"] if isinstance(each, Mapping) else each
        for name, each in known.items()
    }
    ends = [
        record.document.get(side, {}).get("intervals", {})
        for side in ("base", "extended")
    ]
    rows = [
        _parameter(
            p, (base[p.name], value.get(p.name)), [each.get(p.name) for each in ends]
        )
        for p in record.model.parameters
        if p.name in base
    ]
    if not rows:
        return None

    # parameters that these trials tell together better than each alone
    pairs = record.document.get("extended", {}).get("correlations", [])
    said = [
        f"{' and '.join(map(plain, one['parameters']))} ({one['value']:+.2f})".replace(
            "-", "−"
        )
        for one in pairs
    ]
    together = f"Known better together than each alone, by their correlation: {', '.join(said)}."
    beside = [Text(together, "caption")] if said else []
    lead = "Each model is fitted to all trials. What differs is what the base model bends to make up for its mistakes."
    columns = (
        "parameter",
        "",
        "base model",
        "95 % interval",
        "extended model",
        "95 % interval",
        "change",
        "unit",
    )
    return Section(
        "The string's parameters",
        [Text(lead), Card("", [Table(columns, rows), *beside])],
    )


def _parameter(
    of: Parameter,
    values: tuple[float, float | None],
    ends: Sequence[Sequence[float] | None],
) -> list[Any]:
    """A row: values of the base and of the extended model, each with the ends of its
    interval, if they are known.
    """
    base, extended = values
    if extended is None or not base:
        change = ""
    elif 1 / 3 < extended / base < 3:
        percents = round(100 * (extended / base - 1))
        change = f"{percents:+d} %".replace("-", "−") if percents else "0 %"
    else:
        change = f"× {significant(extended / base)}"
    cells: list[Cell] = []
    for value, two in zip(values, ends, strict=True):
        shown, interval = UNKNOWN if value is None else significant(value), ""
        if value is not None and two is not None:
            shown, low, high = within(value, *two)
            interval = f"{low} to {high}"
        cells += [number(shown), number(interval)]
    return [
        Cell(plain(of.name), title=of.meaning),
        symbol(of.symbol),
        *cells,
        number(change),
        unit(of.unit),
    ]
