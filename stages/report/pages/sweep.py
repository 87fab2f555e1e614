"""The page of a sweep: settings, their effect on the outcomes, and failed jobs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from markupsafe import Markup
from matplotlib import style

from stringcast.stages.report.charts.sweep import (
    TARGET_COLUMNS,
    outcome_curve,
    target_map,
)
from stringcast.stages.report.formatting import (
    NOT_KNOWN,
    format_count,
    format_mean,
    format_value,
    unit_markup,
)
from stringcast.stages.report.outcomes import MIN_SEEDS, Outcome, mean_response
from stringcast.stages.report.page import Page
from stringcast.stages.report.parts import (
    Card,
    Cell,
    Container,
    Details,
    Figure,
    Part,
    Section,
    Small,
    TableView,
    Text,
    Tiles,
    bold_text,
    join_sentences,
    link,
    number_cell,
    number_cells,
    table_card,
)
from stringcast.stages.report.records import SweepRecord
from stringcast.stages.report.theme import STYLE_SHEET

MAIN_OUTCOMES = ("hit", "casts", "E_after")


def sweep_page(record: SweepRecord) -> str:
    """Render the page of a sweep."""
    main = [outcome for outcome in record.outcomes if outcome.name in MAIN_OUTCOMES]
    with style.context(STYLE_SHEET):
        sections = [_tiles(record, main), _failures_section(record)]
        sections += [_response_section(record, factor) for factor in record.factors]
        sections.append(_targets_section(record))
    sections += [_combinations_section(record, main), _jobs_section(record)]

    varied = "No setting was varied."
    if record.factors:
        varied = f"Varied: {', '.join(record.factors)}."
    intervals = "Bars and brackets are 95 % intervals of means over the seeds."
    if record.seed_count < MIN_SEEDS:
        intervals = (
            f"There are no intervals, because fewer than {MIN_SEEDS} seeds hardly show "
            "the scatter of a mean."
        )
    seeds = f"Each with {format_count(record.seed_count, 'seed')}."
    page = Page(
        kind="sweep",
        name=record.name,
        heading=_describe_largest_effect(record, main) or record.sentence,
        lead=f"{record.sentence}. {varied} {seeds} {intervals}",
        sections=sections,
        origin=record.provenance,
        settings=record.settings,
    )
    return str(page)


def _describe_largest_effect(record: SweepRecord, main: list[Outcome]) -> str:
    """Describe the largest effect of a setting, on the first outcome that changes.

    An outcome changes if the intervals of its least and largest mean do not overlap.
    Returns nothing if there are too few seeds for intervals.
    """
    has_intervals = record.seed_count >= MIN_SEEDS
    if not record.factors or record.finished_jobs.empty or not has_intervals:
        return ""
    for outcome in main:
        largest, sentence = 0.0, ""
        for factor in record.factors:
            means = mean_response(record.finished_jobs, outcome, [factor])
            low = means.loc[means["mean"].idxmin()]
            high = means.loc[means["mean"].idxmax()]
            size = high["mean"] - low["mean"]
            if low["high"] < high["low"] and size > largest:
                largest = size
                unit = f" {outcome.unit}" if outcome.unit else ""
                best = (
                    f"{format_value(high['mean'])}{unit} with {factor}={high[factor]}"
                )
                worst = f"{format_value(low['mean'])}{unit} with {low[factor]}"
                sentence = f"The {outcome.label} is {best}, {worst}"
        if sentence:
            return sentence
    return f"No varied setting changes the {main[0].label} significantly"


def _tiles(record: SweepRecord, main: list[Outcome]) -> Tiles:
    failed = Markup("")
    if count := len(record.failed_jobs):
        failed = Markup(', <strong class="bad">{} failed</strong>').format(count)
    seconds = record.jobs["seconds"].sum()
    spent = f"; {seconds:.0f} s of computing in their last attempts"
    done = f"{len(record.finished_jobs)} of {len(record.jobs)}"
    meaning = Markup("jobs done{}{}").format(failed, spent)
    tiles: list[tuple[str, str]] = [(done, meaning)]
    jobs = record.finished_jobs.assign(all=0)
    for outcome in main:
        (row,) = mean_response(jobs, outcome, ["all"]).to_dict("records")
        unit = " %" if outcome.unit == "%" else ""
        label = f"{outcome.label}, mean of all finished jobs"
        tiles.append((format_mean(row) + unit, label))
    return Tiles(tiles)


def _failures_section(record: SweepRecord) -> Section | None:
    if record.failed_jobs.empty:
        return None
    lead = (
        "The following sections exclude them, which may favour the levels at which "
        "they failed."
    )
    rows = []
    for job in record.failed_jobs.to_dict("records"):
        attempts = number_cell(job["attempts"])
        rows.append((_job_cell(record, job), job["error"], attempts, job["host"]))
    table = table_card(("job", "error", "attempts", "host"), rows)
    return Section("Failed", [Text(lead), table])


def _job_cell(record: SweepRecord, job: Mapping[str, Any]) -> Cell:
    """Name a job by its varied settings."""
    settings = [f"{name}={job[name]}" for name in record.varied_settings]
    return Cell(" ".join(settings), "code")


def _response_section(record: SweepRecord, factor: str) -> Section:
    """Draw each outcome over a setting."""
    pictures = []
    for outcome in record.outcomes:
        unit = Markup("")
        if outcome.unit not in ("", "1"):
            unit = Markup("[{}]").format(unit_markup(outcome.unit))
        picture = outcome_curve(record.finished_jobs, outcome, factor, record.units)
        if picture:
            pictures.append((join_sentences([bold_text(outcome.label), unit]), picture))
    parts: list[Part] = [Text("No job is finished.", "missing")]
    if pictures:
        lead = "Blue: mean over the other settings and the seeds. Grey: the jobs."
        parts = [Text(lead), Card("", [Small(pictures)])]
    return Section(f"Response to {factor}", parts)


def _targets_section(record: SweepRecord) -> Section | None:
    """Map the casts until a hit over the targets, if their place was varied.

    Each combination of the other settings has a map.
    """
    ended = record.jobs[record.jobs["state"].isin(["done", "failed"])]
    if not set(TARGET_COLUMNS) <= set(record.factors) or record.finished_jobs.empty:
        return None
    max_casts = int(record.finished_jobs["casts"].max())
    others = [name for name in record.factors if name not in TARGET_COLUMNS]
    maps = []
    for level, jobs in ended.groupby(others) if others else [((), ended)]:
        title = ", ".join(
            f"{name} {value}" for name, value in zip(others, level, strict=True)
        )
        picture = target_map(jobs, max_casts)
        maps.append(Figure(title or "All", picture, picture.alt))
    lead = (
        "A mark at each target. Blue: casts until the tip hit, median of the seeds. "
        "Hollow: the median seed did not hit. Crosses: every job failed."
    )
    return Section("Targets", [Text(lead), Container("grid", maps)])


def _combinations_section(record: SweepRecord, main: list[Outcome]) -> Section | None:
    """Tabulate the mean outcomes for each combination of settings."""
    factors = record.factors
    if not factors or record.finished_jobs.empty:
        return None
    columns = {"jobs": record.finished_jobs.groupby(factors, sort=True).size()}
    for outcome in main:
        means = mean_response(record.finished_jobs, outcome, factors)
        columns[outcome.title] = means.set_index(factors).apply(format_mean, axis=1)
    combinations = pd.concat(columns, axis=1).fillna(NOT_KNOWN).reset_index()
    table = []
    for row in combinations.to_numpy(object).tolist():
        table.append([*row[: len(factors)], *number_cells(row[len(factors) :])])
    summary = f"{format_count(len(table), 'combination')} of settings"
    folded = Details(summary, [TableView([*factors, *columns], table)])
    return Section("All combinations", [folded])


def _jobs_section(record: SweepRecord) -> Section:
    """List every job, with a link to its own report."""
    rows = []
    for job in record.jobs.to_dict("records"):
        report = job["key"]
        if job["state"] == "done":
            report = link(f"{job['folder']}/report.html", report)
        numbers = number_cells([job["attempts"], f"{job['seconds']:.1f}"])
        rows.append(
            (_job_cell(record, job), job["state"], *numbers, job["host"], report)
        )
    columns = ("job", "state", "attempts", "seconds", "host", "report")
    summary = f"{format_count(len(rows), 'job')}, with their own reports"
    return Section("Jobs", [Details(summary, [TableView(columns, rows)])])
