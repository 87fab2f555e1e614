"""The engine of studies: jobs side by side, each kept on disk as soon as it is done;
then tables, pictures, a sentence.

What is in the study's folder already is not made again, so that it goes on where it
stopped, and for more rows, too.
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

from stringcast.data.schema import Table
from stringcast.data.store import write_table, write_text
from stringcast.pipeline.cli.console import progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.modes.stepwise import refuse_trials
from stringcast.pipeline.run.experiment import Experiment, Mode
from stringcast.pipeline.run.provenance import step_origin
from stringcast.pipeline.run.result import RunResult
from stringcast.stages.common import Progress

ONE_THREAD = {
    "NUMBA_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}


class StudyJob(ABC):
    """One job of a study: it makes a row, or several, in a process of its own; it can
    be pickled.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of the file that keeps the result: one of its own in its study, for
        good.
        """

    @abstractmethod
    def __call__(self) -> Any:
        """Make it, as JSON can hold it."""


class Study(Mode):
    """A description: which jobs there are, which tables are counted from what they
    made, what is drawn and said.

    KIND: its name in the origin of its tables. TABLES: by name. BLOCK: its settings, of
    which MORE say only how many rows are made. LIVES: jobs after which a process is
    replaced by a new one, if any.
    """

    KIND: ClassVar[str]
    TABLES: ClassVar[Mapping[str, Table]]
    BLOCK: ClassVar[str]
    MORE: ClassVar[tuple[str, ...]]
    LIVES: ClassVar[int | None] = None

    @abstractmethod
    def jobs(self, experiment: Experiment, folder: Path) -> Sequence[StudyJob]:
        """All jobs, in the order of their rows. Raises UserError for settings that
        cannot be used.
        """

    @abstractmethod
    def tables(
        self, experiment: Experiment, made: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Tables by name. made: each job with what it made."""

    @abstractmethod
    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Leave pictures in the study's folder."""

    @abstractmethod
    def sentence(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """The study's result in a sentence or two, for terminal and log."""

    @property
    def growing(self) -> Mapping[str, Sequence[str]]:
        return {self.BLOCK: self.MORE}

    def check(self, experiment: Experiment) -> None:
        refuse_trials(experiment)

    def perform(
        self, experiment: Experiment, folder: Path, console: Terminal
    ) -> RunResult:
        with progress_bars(console) as bar, bar(experiment.config["name"]) as progress:
            sentence = self.run(experiment, folder, progress)
        console.print(sentence, soft_wrap=True, markup=False)
        return RunResult(folder, (), sentence)

    def run(self, experiment: Experiment, folder: Path, progress: Progress) -> str:
        """Make what is missing, count and draw; what came out, in a sentence. Raises
        what a job raised if all did.
        """
        jobs = self.jobs(experiment, folder)
        processes = experiment.config[self.BLOCK]["processes"]
        made, failed = all_made(
            jobs, folder, processes, lives=self.LIVES, progress=progress
        )
        if not made:
            raise next(iter(failed.values()))
        tables = self.tables(
            experiment, [(job, made[job.name]) for job in jobs if job.name in made]
        )
        for name, frame in tables.items():
            by = step_origin(experiment.config, self.KIND, experiment.seed, {})
            write_table(self.TABLES[name], frame, folder / f"{name}.parquet", by)
        self.draw(tables, folder)
        missing = (
            f"Not made: {name}: {type(why).__name__}: {why}."
            for name, why in failed.items()
        )
        return " ".join([self.sentence(tables), *missing])


def all_made(
    jobs: Sequence[StudyJob],
    folder: Path,
    processes: int,
    *,
    lives: int | None = None,
    progress: Progress = lambda share: None,
) -> tuple[dict[str, Any], dict[str, BaseException]]:
    """Results of jobs by their names, and exceptions of those that failed."""
    made = {job.name: kept(job, folder) for job in jobs if place(job, folder).exists()}
    failed: dict[str, BaseException] = {}
    with workers(processes, lives) as pool:
        asked = {
            pool.submit(kept, job, folder): job.name
            for job in jobs
            if job.name not in made
        }
        for future in as_completed(asked):
            if error := future.exception():
                failed[asked[future]] = error
            else:
                made[asked[future]] = future.result()
            progress((len(made) + len(failed)) / len(jobs))
    return made, failed


def place(job: StudyJob, folder: Path) -> Path:
    """The file that keeps what a job made."""
    return folder / "rows" / f"{job.name}.json"


def kept(job: StudyJob, folder: Path) -> Any:
    """The result of a job, read from the study's folder if it is there, else made and
    kept.
    """
    path = place(job, folder)
    if not path.exists():
        write_text(path, json.dumps(job()))
    return json.loads(path.read_text(encoding="utf-8"))


@contextmanager
def workers(processes: int, lives: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each, that end with this one; 0 is one for each core.
    lives: calls after which a process is replaced by a new one.
    """
    # threads of numba do not live through a fork
    context = multiprocessing.get_context("spawn")
    count = processes or os.cpu_count() or 1
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)  # which processes inherit when they are begun
    try:
        with ProcessPoolExecutor(
            count, context, end_with_parent, max_tasks_per_child=lives
        ) as pool:
            yield pool
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def end_with_parent() -> None:
    """Have this process end when its parent does, however that was killed; it would go
    on for hours.
    """
    threading.Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
