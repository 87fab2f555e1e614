"""The page of a sweep: what was varied, what came of it, and which jobs failed."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

from markupsafe import Markup
from matplotlib import style

from stringcast.stages.report.charts.map import PLACE, curve, plane, reach
from stringcast.stages.report.formatting import (
    UNKNOWN,
    mean_with_interval,
    significant,
    unit,
)
from stringcast.stages.report.outcomes import Outcome, response
from stringcast.stages.report.page import (
    Card,
    Cell,
    Details,
    Figure,
    Grid,
    Page,
    Part,
    Section,
    Small,
    Table,
    Text,
    Tile,
    Tiles,
    bold,
    joined,
    link,
    number,
)
from stringcast.stages.report.records import SweepRecord
from stringcast.stages.report.theme import STYLE_SHEET

MAPPED = ("hit", "manipulations", "E_after")


def sweep_page(record: SweepRecord) -> str:
    """The page as text; the same record gives the same page."""
    with style.context(STYLE_SHEET):
        responses = [response_to(record, factor) for factor in record.factors]
        sections = [
            tiles(record),
            failed(record),
            *responses,
            reaches(record),
            planes(record),
        ]

    varied = (
        f"Varied: {', '.join(record.factors)}."
        if record.factors
        else "No setting was varied."
    )
    seeds = f"Each with {record.seeds} seed{'s' * (record.seeds != 1)}."
    sure = "Bars and brackets are 95 % intervals of means over the seeds; with few seeds they are wide."
    if record.seeds < 2:
        sure = "With one seed nobody can say how much chance there is in these means, so they have no intervals but "
        sure += "that of the hit rate."
    return str(
        Page(
            title=f"{record.name}: {record.sentence}",
            kicker=f"stringcast sweep · {record.name}",
            heading=finding(record) or record.sentence,
            lead=f"{record.sentence}. {varied} {seeds} {sure}",
            sections=[*sections, combined(record), jobs(record)],
            origin=record.provenance,
            settings=record.settings,
        )
    )


def finding(record: SweepRecord) -> str:
    """The largest effect of a setting on the first outcome that one changes beyond
    chance; empty where no setting was varied or nothing is known.
    """
    if not record.factors or record.done.empty:
        return ""
    outcomes = _mapped(record)
    for outcome in outcomes:
        # the levels with the least and the largest mean, where their intervals lie
        # apart
        means = {
            factor: response(record.done, outcome, [factor])
            for factor in record.factors
        }
        ends = {
            f: (rows.loc[rows["mean"].idxmin()], rows.loc[rows["mean"].idxmax()])
            for f, rows in means.items()
        }
        apart = {f: low for f, low in ends.items() if low[0]["high"] < low[1]["low"]}
        if apart:
            factor = max(
                apart, key=lambda f: float(apart[f][1]["mean"] - apart[f][0]["mean"])
            )
            low, high = apart[factor]
            values = [
                f"{significant(row['mean'])}{outcome.unit and f' {outcome.unit}'}"
                for row in (high, low)
            ]
            return f"The {outcome.label} is {values[0]} with {factor}={high[factor]}, {values[1]} with {low[factor]}"
    return f"No setting varied changes the {outcomes[0].label} by more than chance"


def tiles(record: SweepRecord) -> Tiles:
    """Tiles: the number of jobs done, and the mean of each outcome over all."""
    bad = (
        Markup(', <strong class="bad">{} failed</strong>').format(len(record.failed))
        if len(record.failed)
        else ""
    )
    seconds = (
        f"; {record.jobs['seconds'].sum():.0f} s of computing in their last attempts"
    )
    done = Tile(
        f"{len(record.done)} of {len(record.jobs)}",
        Markup("jobs done{}{}").format(bad, seconds),
    )
    means = []
    for outcome in _mapped(record):
        mean: dict[str, Any] = (
            response(record.done.assign(all=0), outcome, ["all"]).iloc[0].to_dict()
        )
        shown = mean_with_interval(mean) + (" %" if outcome.unit == "%" else "")
        means.append(Tile(shown, f"{outcome.label}, mean of all jobs that are done"))
    return Tiles([done, *means])


def _mapped(record: SweepRecord) -> list[Outcome]:
    return [outcome for outcome in record.outcomes if outcome.name in MAPPED]


def failed(record: SweepRecord) -> Section | None:
    """Jobs that failed, and why."""
    if record.failed.empty:
        return None
    lead = "They are left out of all that follows, which may favour the levels at which they failed."
    rows = [
        (_job(record, j), j["error"], number(j["attempts"]), j["host"])
        for j in record.failed.to_dict("records")
    ]
    return Section(
        "Failed",
        [Text(lead), Card("", [Table(("job", "error", "attempts", "host"), rows)])],
    )


def _job(record: SweepRecord, job: Mapping[str, Any]) -> Cell:
    """A job by the settings in which it differs from others."""
    return Cell(
        " ".join(
            f"{name}={job[name]}"
            for name in record.setting_names
            if record.jobs[name].nunique() > 1
        ),
        "code",
    )


def response_to(record: SweepRecord, factor: str) -> Section:
    """Curves of each outcome over a setting."""
    drawn = [
        (_outcome(outcome), curve(record.done, outcome, factor, record.units))
        for outcome in record.outcomes
    ]
    known = [(words, picture) for words, picture in drawn if picture is not None]
    lead = Text("Blue: mean over the other settings and the seeds. Grey: the jobs.")
    nothing = Text("Nothing is known: no job is done.", "missing")
    return Section(
        f"Response to {factor}",
        [lead, Card("", [Small(known)])] if known else [nothing],
    )


def _outcome(outcome: Outcome) -> Markup:
    measured = (
        Markup("[{}]").format(unit(outcome.unit))
        if outcome.unit not in ("", "1")
        else ""
    )
    return joined([bold(outcome.label), measured])


def reaches(record: SweepRecord) -> Section | None:
    """Maps of the targets, marked by the number of manipulations until they are hit:
    one for each combination of the other settings, where the target's place was varied.
    """
    ended = record.jobs[record.jobs["state"].isin(["done", "failed"])]
    if not set(PLACE) <= set(record.factors) or record.done.empty:
        return None
    most = int(record.done["manipulations"].max())
    others = [name for name in record.factors if name not in PLACE]
    maps = []
    for level, some in ended.groupby(others) if others else [((), ended)]:
        title = ", ".join(
            f"{name} {value}" for name, value in zip(others, level, strict=True)
        )
        picture = reach(some, most)
        maps.append(Figure(title or "All", picture, picture.alt))
    lead = "A mark at each target. Blue: in how many manipulations the tip hit, median of the seeds. Hollow: the "
    lead += (
        "median seed did not hit. Crosses: no job ran to its end; see the failed ones."
    )
    return Section("Where it hits", [Text(lead), Grid(maps)])


def planes(record: SweepRecord) -> Section | None:
    """A map of each outcome over each pair of settings."""
    pairs = list(combinations(record.factors, 2))
    drawn = [
        (_outcome(o), plane(record.done, o, *pair, record.units))
        for pair in pairs
        for o in _mapped(record)
    ]
    known = [(words, picture) for words, picture in drawn if picture is not None]
    lead = Text("Means over the seeds and all other settings; the darker, the larger.")
    return (
        Section("Two settings at a time", [lead, Card("", [Small(known)])])
        if known
        else None
    )


def combined(record: SweepRecord) -> Section | None:
    """A table with a row for each combination of settings and the means of its
    outcomes.
    """
    factors, outcomes = list(record.factors), _mapped(record)
    if not factors:
        return None
    means: dict[tuple[Any, ...], dict[str, Any]] = {}
    for outcome in outcomes:
        for row in response(record.done, outcome, factors).to_dict("records"):
            place = tuple(row[factor] for factor in factors)
            means.setdefault(place, {"jobs": row["jobs"]})[outcome.name] = (
                mean_with_interval(row)
            )
    rows = [
        [
            *place,
            number(means[place]["jobs"]),
            *(number(means[place].get(o.name, UNKNOWN)) for o in outcomes),
        ]
        for place in sorted(means, key=lambda place: [str(level) for level in place])
    ]
    if not rows:
        return None
    summary = f"{len(rows)} combination{'s' * (len(rows) != 1)} of settings"
    table = Table([*factors, "jobs", *(outcome.title for outcome in outcomes)], rows)
    return Section("All combinations", [Details(summary, [table])])


def jobs(record: SweepRecord) -> Part:
    """Every job, with a link to its own report."""
    rows = []
    for job in record.jobs.to_dict("records"):
        report = (
            link(f"{job['folder']}/report.html", job["key"])
            if job["state"] == "done"
            else job["key"]
        )
        cells = (
            number(job["attempts"]),
            number(f"{job['seconds']:.1f}"),
            job["host"],
            report,
        )
        rows.append((_job(record, job), job["state"], *cells))
    summary = f"{len(rows)} job{'s' * (len(rows) != 1)}, with their own reports"
    columns = ("job", "state", "attempts", "seconds", "host", "report")
    return Section("Jobs", [Details(summary, [Table(columns, rows)])])
