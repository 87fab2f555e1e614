"""One tidy table for a sweep: a row a job, its settings, how it ended and what it
found.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from stringcast.data.artifacts import Estimate
from stringcast.data.schema import Column, Table
from stringcast.data.store import read_table
from stringcast.pipeline.sweep.ledger import DONE_STATE, Job, Ledger

SWEEP_TABLE = Table(
    "sweep",
    "a row a job; beside these columns one for each setting that was given, and one for each parameter estimated",
    (
        Column("job", "1", "its place in the command that asked for it", "int"),
        Column("key", "", "hash of all its settings", "text"),
        Column("folder", "", "its run, relative to this file", "text"),
        Column("state", "", "done, failed, pending or running", "text"),
        Column("error", "", "why it failed", "text"),
        Column("attempts", "1", "how often it was begun", "int"),
        Column("seconds", "s", "that the last attempt took"),
        Column("host", "", "machine of the last attempt", "text"),
        Column(
            "hit",
            "1",
            "1: the tip reached the target, 0: it did not; this and what follows is NaN where unknown",
        ),
        Column("manipulations", "1", "casts made, or trials estimated from"),
        Column("E_before", "1", "E before the last estimation"),
        Column("E_after", "1", "E after the last estimation"),
        Column("miss_m", "m", "closest approach of the tip in the last cast"),
    ),
)


def sweep_table(ledger: Ledger, jobs: Sequence[Job]) -> tuple[Table, pd.DataFrame]:
    """The table of these jobs with its schema, in which each setting and each parameter
    is a column. Raises DataError where parameters cannot be read.
    """
    given = setting_columns(jobs)
    # of its last estimation
    found: dict[str, dict[str, tuple[Column, float]]] = {job.key: {} for job in jobs}
    for job in jobs:
        made = sorted(
            ledger.job_folder(job.key).glob("iterations/*/estimate/parameters.parquet")
        )
        if job.state == DONE_STATE and made:
            rows = read_table(Estimate.TABLES["parameters"], made[-1]).itertuples()
            found[job.key] |= {
                r.name: (Column(r.name, r.unit, r.meaning, optional=True), r.value)
                for r in rows
            }
    names = {
        name: column
        for parameters in found.values()
        for name, (column, _) in parameters.items()
    }
    frame = pd.DataFrame([job_row(ledger, job) for job in jobs])
    for name, column in given.items():
        frame[name] = column
    for name in names:
        frame[name] = [
            found[job.key].get(name, (None, float("nan")))[1] for job in jobs
        ]
    kinds = {"i": "int", "f": "float"}  # of NumPy's; text for others
    settings = tuple(
        Column(
            name, "", f"the setting {name}", kinds.get(frame[name].dtype.kind, "text")
        )
        for name in given
    )
    return replace(
        SWEEP_TABLE, columns=(*SWEEP_TABLE.columns, *settings, *names.values())
    ), frame


def setting_columns(jobs: Sequence[Job]) -> dict[str, list[Any]]:
    """Settings that were given to any of the jobs, by column, with the value of each
    job: numbers, or else text.

    A column has the setting's name, unless an outcome has it: `manipulations` are asked
    for, and made.
    """
    given = [
        dict(
            override.lstrip("+~").split("=", 1)
            for override in job.overrides
            if "=" in override
        )
        for job in jobs
    ]
    names = dict.fromkeys(name for one in given for name in one)
    taken = {column.name for column in SWEEP_TABLE.columns}
    columns: dict[str, list[Any]] = {}
    for name in names:
        values = [
            setting_value(job, name, one) for job, one in zip(jobs, given, strict=True)
        ]
        numbers = all(
            isinstance(value, int | float) and not isinstance(value, bool)
            for value in values
        )
        columns[f"setting.{name}" if name in taken else name] = (
            values if numbers else list(map(str, values))
        )
    return columns


def setting_value(job: Job, name: str, given: Mapping[str, str]) -> Any:
    """A setting as it stands among a job's settings; of a group or list, as it was
    given.
    """
    here: Any = job.settings
    for part in name.split("."):
        here = here.get(part) if isinstance(here, Mapping) else None
    return here if isinstance(here, bool | int | float | str) else given.get(name, "")


def job_row(ledger: Ledger, job: Job) -> dict[str, Any]:
    """A job, and how its run ended, from its run.json; NaN where it did not, and for
    what it does not have.
    """
    place = ledger.job_folder(job.key)
    known = {
        "job": job.number,
        "key": job.key,
        "folder": place.name,
        "state": job.state,
    }
    known |= {
        "error": job.error,
        "attempts": job.attempts,
        "seconds": job.seconds,
        "host": job.host,
    }
    path = place / "run.json"
    done = job.state == DONE_STATE and path.exists()
    ended: dict[str, Any] = (
        json.loads(path.read_text(encoding="utf-8")) if done else {"iterations": []}
    )
    casts = ended["iterations"]
    numbers = {
        name: casts[-1].get(name) if casts else None
        for name in ("E_before", "E_after", "miss_m")
    }
    numbers |= {"hit": ended["hit"] if any("hit" in cast for cast in casts) else None}
    numbers |= {"manipulations": len(casts) or None}
    return known | {
        name: float("nan") if value is None else float(value)
        for name, value in numbers.items()
    }
