"""Write one table and one page for all jobs of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stringcast.data.store import write_table, write_text
from stringcast.pipeline.run.provenance import software_versions
from stringcast.pipeline.settings.setting_comments import setting_units
from stringcast.pipeline.sweep.ledger import DONE_STATE, Job, Ledger
from stringcast.pipeline.sweep.table import SWEEP_TABLE, setting_columns, sweep_table
from stringcast.stages.report.formatting import setting_texts
from stringcast.stages.report.pages.sweep import sweep_page
from stringcast.stages.report.records import SweepRecord


def finish(folder: Path) -> list[Job]:
    """Write `sweep.parquet` and `report.html` from the ledger, and return its jobs."""
    ledger = Ledger(folder)
    jobs = ledger.jobs()
    versions = software_versions()
    table, frame = sweep_table(ledger, jobs)
    write_table(table, frame, folder / "sweep.parquet", {"step": "sweep"} | versions)
    settings = list(setting_columns(jobs))
    other_columns = {column.name for column in SWEEP_TABLE.columns} | set(settings)
    parameter_columns = {}
    for column in table.columns:
        if column.name not in other_columns:
            parameter_columns[column.name] = column.unit
    done_count = sum(job.state == DONE_STATE for job in jobs)
    record = SweepRecord(
        name=str(jobs[0].settings["name"]),
        sentence=f"{done_count} of {len(jobs)} jobs are done",
        jobs=frame,
        setting_names=settings,
        parameter_columns=parameter_columns,
        settings=common_settings(jobs),
        provenance={"seed": "of each job"} | versions,
        units=setting_units(settings),
    )
    write_text(folder / "report.html", sweep_page(record))
    return jobs


def common_settings(jobs: Sequence[Job]) -> Mapping[str, Any]:
    """Return the settings that all jobs share, by their names on the command line."""
    first, *others = [dict(setting_texts(job.settings)) for job in jobs]
    common = {}
    for name, value in first.items():
        if all(settings.get(name) == value for settings in others):
            common[name] = value
    return common
