"""The end of a sweep: one table and one page for all its jobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stringcast.data.store import write_table, write_text
from stringcast.pipeline.run.provenance import software_versions
from stringcast.pipeline.settings.setting_comments import setting_units
from stringcast.pipeline.sweep.ledger import DONE_STATE, Job, Ledger
from stringcast.pipeline.sweep.table import SWEEP_TABLE, setting_columns, sweep_table
from stringcast.stages.report.formatting import flatten_settings as flat
from stringcast.stages.report.pages.sweep import sweep_page
from stringcast.stages.report.records import SweepRecord


def finish(folder: Path) -> list[Job]:
    """Write `sweep.parquet` and `report.html` from the ledger as it is now. Returns its
    jobs.
    """
    ledger = Ledger(folder)
    jobs = ledger.jobs()
    made = software_versions()
    table, frame = sweep_table(ledger, jobs)
    write_table(table, frame, folder / "sweep.parquet", {"step": "sweep"} | made)
    given = list(setting_columns(jobs))
    known = {column.name for column in SWEEP_TABLE.columns}.union(given)
    record = SweepRecord(
        name=str(jobs[0].settings["name"]),
        sentence=f"{sum(job.state == DONE_STATE for job in jobs)} of {len(jobs)} jobs are done",
        jobs=frame,
        setting_names=given,
        parameter_columns={
            c.name: c.unit for c in table.columns if c.name not in known
        },
        settings=common_settings(jobs),
        provenance={"seed": "of each job"} | made,
        units=setting_units(given),
    )
    write_text(folder / "report.html", sweep_page(record))
    return jobs


def common_settings(jobs: Sequence[Job]) -> Mapping[str, Any]:
    """The settings that all jobs have alike, by their names on the command line."""
    known = [dict(flat(job.settings)) for job in jobs]
    return {
        name: value
        for name, value in known[0].items()
        if all(one.get(name) == value for one in known)
    }
