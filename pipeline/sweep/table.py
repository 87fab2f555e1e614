"""Make one tidy table of a sweep: settings, state and results of each job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from stringcast.data.estimates import Estimate
from stringcast.data.schema import Column, Table, parse_columns
from stringcast.data.store import read_table
from stringcast.pipeline.run.file_names import artifact_tables
from stringcast.pipeline.settings.composition import setting_of
from stringcast.pipeline.sweep.ledger import DONE_STATE, Job, Ledger

SWEEP_TABLE = Table(
    "sweep",
    "a row for each job; further columns hold given settings and estimated parameters",
    parse_columns("""
    job [1] (int): position in the command that named it
    key (text): hash of all settings
    folder (text): folder of the run, relative to this file
    state (text): done, failed, pending or running
    error (text): why the job failed
    attempts [1] (int): number of attempts
    seconds [s]: duration of the last attempt
    host (text): machine of the last attempt
    hit [1]: 1: the tip reached the target, 0: it did not; NaN: unknown
    casts [1]: casts made, or trials estimated from
    E_before [1]: E before the last estimation
    E_after [1]: E after the last estimation
    miss_m [m]: closest approach of the tip in the last cast
    """),
)


def sweep_table(ledger: Ledger, jobs: Sequence[Job]) -> tuple[Table, pd.DataFrame]:
    """Return the table of jobs and its schema.

    Each given setting and each estimated parameter is a column of its own.

    Raises DataError if the parameters of a job cannot be read.
    """
    frame = pd.DataFrame([job_row(ledger, job) for job in jobs])
    setting_kinds = {"i": "int", "f": "float"}  # by NumPy's kind; text for others
    columns = []
    for name, values in setting_columns(jobs).items():
        frame[name] = values
        kind = setting_kinds.get(frame[name].dtype.kind, "text")
        columns.append(Column(name, "", f"the setting {name}", kind))

    parameter_columns: dict[str, Column] = {}
    parameters = [last_parameters(ledger, job) for job in jobs]
    for table in parameters:
        for row in table.itertuples():
            column = Column(row.name, row.unit, row.meaning, optional=True)
            parameter_columns[row.name] = column
    for name in parameter_columns:
        frame[name] = [
            table.set_index("name")["value"].get(name, float("nan"))
            for table in parameters
        ]
    columns = [*SWEEP_TABLE.columns, *columns, *parameter_columns.values()]
    return replace(SWEEP_TABLE, columns=tuple(columns)), frame


def last_parameters(ledger: Ledger, job: Job) -> pd.DataFrame:
    """Return the parameter table of a job's last estimation, or an empty one."""
    paths = artifact_tables(ledger.job_folder(job.key), "estimate", "parameters")
    table = Estimate.TABLES["parameters"]
    if job.state != DONE_STATE or not paths:
        return table.empty()
    return read_table(table, paths[-1])


def setting_columns(jobs: Sequence[Job]) -> dict[str, list[Any]]:
    """Return the settings given to any job, with the value of each job.

    Values are numbers or text. If an outcome has the same name, a column's name begins
    with `setting.`.
    """
    given_by_job = []
    for job in jobs:
        pairs = [word.lstrip("+~").split("=", 1) for word in job.overrides]
        given_by_job.append({pair[0]: pair[1] for pair in pairs if len(pair) > 1})
    names = dict.fromkeys(name for given in given_by_job for name in given)
    outcomes = {column.name for column in SWEEP_TABLE.columns}
    columns: dict[str, list[Any]] = {}
    for name in names:
        values = []
        for job, given in zip(jobs, given_by_job, strict=True):
            values.append(setting_value(job, name, given))
        if not all(type(value) in (int, float) for value in values):
            values = [str(value) for value in values]
        columns[f"setting.{name}" if name in outcomes else name] = values
    return columns


def setting_value(job: Job, name: str, given: Mapping[str, str]) -> Any:
    """Return a job's value of a setting; for a group or list, the given text."""
    value = setting_of(job.settings, name)
    return value if isinstance(value, bool | int | float | str) else given.get(name, "")


def job_row(ledger: Ledger, job: Job) -> dict[str, Any]:
    """Return the row of a job, with the outcome of its run from run.json."""
    row: dict[str, Any] = {"job": job.number, "key": job.key, "folder": job.key}
    for name in ("state", "error", "attempts", "seconds", "host"):
        row[name] = getattr(job, name)
    casts = ledger.casts(job.key) if job.state == DONE_STATE else []
    last = casts[-1] if casts else {}
    hits = [cast["hit"] for cast in casts if "hit" in cast]
    outcome = {"hit": any(hits) if hits else None, "casts": len(casts) or None}
    for name in ("E_before", "E_after", "miss_m"):
        outcome[name] = last.get(name)
    for name, value in outcome.items():
        row[name] = float("nan") if value is None else float(value)
    return row
