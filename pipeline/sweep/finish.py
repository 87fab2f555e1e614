"""The end of a sweep: one table and one page for all its jobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stringcast.data.store import write_table, write_text
from stringcast.pipeline.meanings import units
from stringcast.pipeline.provenance import software
from stringcast.pipeline.sweep.ledger import DONE, Job, Ledger
from stringcast.pipeline.sweep.table import SWEEP, factors, sweep_table
from stringcast.stages.report.pages.sweep import sweep_page
from stringcast.stages.report.records import SweepRecord
from stringcast.stages.report.words import settings as flat


def finish(folder: Path) -> list[Job]:
    """Write `sweep.parquet` and `report.html` from the ledger as it is now. Returns its jobs."""
    ledger = Ledger(folder)
    jobs = ledger.jobs()
    made = software()
    table, frame = sweep_table(ledger, jobs)
    write_table(table, frame, folder / "sweep.parquet", {"step": "sweep"} | made)
    given = list(factors(jobs))
    known = {column.name for column in SWEEP.columns}.union(given)
    record = SweepRecord(
        name=str(jobs[0].settings["name"]),
        sentence=f"{sum(job.state == DONE for job in jobs)} of {len(jobs)} jobs are done",
        table=frame,
        given=given,
        estimated={c.name: (c.unit, c.meaning) for c in table.columns if c.name not in known},
        settings=common(jobs),
        origin={"seed": "of each job"} | made,
        units=units(given),
    )
    write_text(folder / "report.html", sweep_page(record))
    return jobs


def common(jobs: Sequence[Job]) -> Mapping[str, Any]:
    """The settings that all jobs have alike, by their names on the command line."""
    known = [dict(flat(job.settings)) for job in jobs]
    return {name: value for name, value in known[0].items() if all(one.get(name) == value for one in known)}
