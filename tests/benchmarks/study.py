"""Studies: independent jobs, then tables, pictures and a sentence.

Each result is kept on disk as soon as it is done. A job whose result lies in the
study's folder is not run again. The same command therefore continues a study that was
interrupted, and extends one that asks for more rows.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
from omegaconf import OmegaConf

from stringcast.data.schema import Table
from stringcast.data.store import write_table, write_text
from stringcast.pipeline.run.provenance import step_origin
from stringcast.pipeline.settings.composition import (
    UserError,
    compose_settings,
    flatten_settings,
)
from stringcast.stages.common import Progress

Config = Mapping[str, Any]
CONF = Path(__file__).resolve().with_name("conf")
SINGLE_THREAD = {
    "NUMBA_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}


class StudyJob(ABC):
    """One job of a study.

    It runs in a process of its own and can be pickled.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the file that keeps the result, unique within the study."""

    @abstractmethod
    def __call__(self) -> Any:
        """Return the result, as JSON can hold it."""


class Study(ABC):
    """Jobs of a study, and what is made of their results.

    Attributes
    ----------
    TABLES
        Schemas of the tables, by name.
    BLOCK
        Name of the study's settings block.
    GROWING
        Settings of that block that only determine the number of rows. They may change
        between calls.
    CALLS_PER_PROCESS
        Jobs after which a worker process is replaced by a new one; None for never.
    """

    TABLES: ClassVar[Mapping[str, Table]]
    BLOCK: ClassVar[str]
    GROWING: ClassVar[tuple[str, ...]]
    CALLS_PER_PROCESS: ClassVar[int | None] = None

    @abstractmethod
    def jobs(self, config: Config, folder: Path) -> Sequence[StudyJob]:
        """Return all jobs, in the order of their rows.

        Raises UserError for settings that cannot be used.
        """

    @abstractmethod
    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return the tables by name.

        `results` are pairs of a job and its result.
        """

    @abstractmethod
    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Write pictures into the study's folder."""

    @abstractmethod
    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return the study's result in a sentence or two."""


def study_settings(name: str, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Compose the settings of a study.

    They are those of the product with conf/study/<name>.yaml on top.
    """
    config = compose_settings(
        [f"hydra.searchpath=[{CONF.as_uri()}]", f"+study={name}", *overrides]
    )
    resolved: Any = OmegaConf.to_container(OmegaConf.create(config), resolve=True)
    return dict(resolved)


def run_study(study: Study, config: Config, folder: Path, progress: Progress) -> str:
    """Run the missing jobs, write tables and pictures, and return the summary.

    Raises the error of a job if every job failed; otherwise failed jobs are named in
    the summary.
    """
    keep_settings(study, config, folder)
    jobs = study.jobs(config, folder)
    processes = config[study.BLOCK]["processes"]
    results, errors = run_jobs(
        jobs, folder, processes, study.CALLS_PER_PROCESS, progress
    )
    if not results:
        raise next(iter(errors.values()))

    finished = [(job, results[job.name]) for job in jobs if job.name in results]
    tables = study.tables(config, finished)
    for name, frame in tables.items():
        made_by = step_origin(config, "study", config["seed"], {})
        write_table(study.TABLES[name], frame, folder / f"{name}.parquet", made_by)
    study.draw(tables, folder)
    failures = [
        f"Failed: {name}: {type(error).__name__}: {error}."
        for name, error in errors.items()
    ]
    return " ".join([study.summary(tables), *failures])


def keep_settings(study: Study, config: Config, folder: Path) -> None:
    """Write config.json, or check that the folder's study has the same settings."""
    path = folder / "config.json"
    text = json.dumps(config, indent=2, sort_keys=True)
    if path.exists():
        growing = {f"{study.BLOCK}.{name}" for name in study.GROWING} | {"folder"}
        before = flatten_settings(json.loads(path.read_text(encoding="utf-8")))
        now = flatten_settings(json.loads(text))
        changed = [
            name
            for name in {**before, **now}
            if name not in growing and before.get(name) != now.get(name)
        ]
        if changed:
            raise UserError(
                folder,
                "this folder holds a study with other settings "
                f"({', '.join(sorted(changed))})",
                "Choose another folder=..., or repeat its settings.",
            )
    write_text(path, text)


def run_jobs(
    jobs: Sequence[StudyJob],
    folder: Path,
    processes: int,
    calls_per_process: int | None = None,
    progress: Progress = lambda share: None,
) -> tuple[dict[str, Any], dict[str, BaseException]]:
    """Return results of jobs by name, and errors of those that failed."""
    results = {
        job.name: stored_result(job, folder)
        for job in jobs
        if result_path(job, folder).exists()
    }
    errors: dict[str, BaseException] = {}
    with worker_pool(processes, calls_per_process) as pool:
        names = {}
        for job in jobs:
            if job.name not in results:
                names[pool.submit(stored_result, job, folder)] = job.name
        for future in as_completed(names):
            if error := future.exception():
                errors[names[future]] = error
            else:
                results[names[future]] = future.result()
            progress((len(results) + len(errors)) / len(jobs))
    return results, errors


def result_path(job: StudyJob, folder: Path) -> Path:
    """Return the file that keeps the result of a job."""
    return folder / "rows" / f"{job.name}.json"


def stored_result(job: StudyJob, folder: Path) -> Any:
    """Return the stored result of a job, or run the job and keep its result."""
    path = result_path(job, folder)
    if not path.exists():
        write_text(path, json.dumps(job()))
    return json.loads(path.read_text(encoding="utf-8"))


@contextmanager
def worker_pool(
    processes: int, calls_per_process: int | None = None
) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of single-threaded processes that end with this one.

    `processes` is 0 for one per core.
    """
    # Numba's threads do not survive a fork
    context = multiprocessing.get_context("spawn")
    count = processes or os.cpu_count() or 1
    before = {name: os.environ.get(name) for name in SINGLE_THREAD}
    os.environ.update(SINGLE_THREAD)  # processes inherit it when they start
    try:
        with ProcessPoolExecutor(
            count, context, end_with_parent, max_tasks_per_child=calls_per_process
        ) as pool:
            yield pool
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def end_with_parent() -> None:
    """End this process when its parent ends, however the parent was killed."""
    threading.Thread(target=_exit_after_parent, daemon=True).start()


def _exit_after_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
