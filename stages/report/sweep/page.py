"""The page of a sweep: what was varied, what came of it, and which jobs failed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from matplotlib import style

from stringcast.stages.report.picture import STYLE, Picture
from stringcast.stages.report.sweep.figures.curve import curve
from stringcast.stages.report.sweep.figures.plane import plane
from stringcast.stages.report.sweep.figures.reach import PLACE, reach
from stringcast.stages.report.sweep.outcomes import Outcome, response
from stringcast.stages.report.sweep.record import SweepRecord
from stringcast.stages.report.template import template
from stringcast.stages.report.words import significant

MAPPED = ("hit", "manipulations", "E_after")


def sweep_report(record: SweepRecord) -> str:
    """The page as text; the same record gives the same page."""
    with style.context(STYLE):
        return template("sweep/page.html.j2", interval).render(
            record=record,
            whole=[(outcome, _overall(record, outcome)) for outcome in record.outcomes if outcome.name in MAPPED],
            curves={factor: list(_curves(record, factor)) for factor in record.factors},
            planes=list(_planes(record)),
            reaches=list(_reaches(record)),
            settings=_settings(record),
            jobs=record.table.to_dict("records"),
        )


def interval(row: dict[str, Any]) -> str:
    """A mean with its interval, where it has one."""
    ends = f" ({significant(row['low'])} to {significant(row['high'])})" if row["low"] == row["low"] else ""
    return significant(row["mean"]) + ends


def _overall(record: SweepRecord, outcome: Outcome) -> dict[str, Any]:
    """Mean of an outcome over all jobs."""
    everywhere = record.done.assign(everywhere=0)
    mean: dict[str, Any] = response(everywhere, outcome, ["everywhere"]).iloc[0].to_dict()
    return mean


def _curves(record: SweepRecord, factor: str) -> list[tuple[Outcome, Picture]]:
    drawn = [(outcome, curve(record.done, outcome, factor)) for outcome in record.outcomes]
    return [(outcome, picture) for outcome, picture in drawn if picture is not None]


def _planes(record: SweepRecord) -> list[tuple[Outcome, Picture]]:
    """A map of each outcome over each pair of settings."""
    pairs = list(combinations(record.factors, 2))
    drawn = [(o, plane(record.done, o, *pair)) for pair in pairs for o in record.outcomes if o.name in MAPPED]
    return [(outcome, picture) for outcome, picture in drawn if picture is not None]


def _reaches(record: SweepRecord) -> Iterator[tuple[str, Picture]]:
    """A map of the workspace for each combination of the other settings, where the target's place was varied."""
    ended = record.table[record.table["state"].isin(["done", "failed"])]
    if not set(PLACE) <= set(record.factors) or record.done.empty:
        return
    most = int(record.done["manipulations"].max())
    others = [name for name in record.factors if name not in PLACE]
    for level, some in ended.groupby(others) if others else [((), ended)]:
        yield ", ".join(f"{name} {value}" for name, value in zip(others, level, strict=True)), reach(some, most)


def _settings(record: SweepRecord) -> list[dict[str, Any]]:
    """Each combination of settings with the means of the outcomes there."""
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    for outcome in record.outcomes if record.factors else ():
        if outcome.name in MAPPED:
            for row in response(record.done, outcome, list(record.factors)).to_dict("records"):
                place = tuple(row[factor] for factor in record.factors)
                rows.setdefault(place, {"place": place, "jobs": row["jobs"]})[outcome.name] = row
    return [rows[place] for place in sorted(rows, key=lambda place: [str(level) for level in place])]
