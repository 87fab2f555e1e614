"""One tidy table for a sweep: a row a job, its overrides and how it ended."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from data.schema import Column, Table
from data.store import write_table
from pipeline.origin import PACKAGES, code, versions

SWEEP = Table(
    "sweep",
    "a row a job; beside these columns one for each setting that was given, as text",
    (
        Column("job", "1", "number of the job", "int"),
        Column("folder", "", "where its run is", "text"),
        Column("completed", "", "it ran to its end", "bool"),
        Column("hit", "", "the tip reached the target", "bool"),
        Column("manipulations", "1", "casts made", optional=True),
        Column("E_before", "1", "E before the last estimation", optional=True),
        Column("E_after", "1", "E after the last estimation", optional=True),
        Column("miss_m", "m", "closest approach of the tip in the last cast", optional=True),
    ),
)


class SweepTable(Callback):
    """Writes `sweep.parquet` into the sweep's folder when all jobs are done."""

    def __init__(self) -> None:
        """No job has ended yet."""
        self.rows: list[dict[str, Any]] = []

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Note a job's overrides and its run.json."""
        if job_return.hydra_cfg is None or job_return.hydra_cfg.hydra.mode != RunMode.MULTIRUN:
            return
        hydra = job_return.hydra_cfg.hydra
        row: dict[str, Any] = dict(o.lstrip("+").split("=", 1) for o in job_return.overrides or [])
        ended = Path(hydra.runtime.output_dir) / "run.json"
        self.rows.append({"job": hydra.job.num} | row | outcome(ended, job_return.status == JobStatus.COMPLETED))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write the table."""
        folder = Path(config.hydra.sweep.dir)
        made = {"step": "sweep", "code": code(), "packages": versions(PACKAGES)}
        write_table(SWEEP, pd.DataFrame(self.rows), folder / "sweep.parquet", made)


def outcome(path: Path, completed: bool) -> dict[str, Any]:
    """How a job ended, from its run.json."""
    if not completed or not path.exists():
        return {"folder": str(path.parent), "completed": False, "hit": False}
    ended = json.loads(path.read_text(encoding="utf-8"))
    last = ended["iterations"][-1]
    return {
        "folder": str(path.parent),
        "completed": True,
        "hit": ended["hit"],
        "manipulations": len(ended["iterations"]),
        "E_before": last["E_before"],
        "E_after": last["E_after"],
        "miss_m": last.get("miss_m"),
    }
