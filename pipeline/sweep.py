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
        folder.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(self.rows).to_parquet(folder / "sweep.parquet", index=False)


def outcome(path: Path, completed: bool) -> dict[str, Any]:
    """How a job ended, from its run.json."""
    if not completed or not path.exists():
        return {"folder": str(path.parent), "completed": False}
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
