"""The Hydra launcher behind every `hydra/launcher=`: it keeps the ledger and runs what
is missing.

Hydra's sweeper says which jobs there are; here each becomes an entry of the ledger, and
those that have not ended are given to the function that the config names.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import timedelta
from math import nan
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from rich.text import Text

from stringcast.pipeline.cli.console import progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.typed_settings import bind_stage, load_callable
from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.ledger import DONE_STATE, FAILED_STATE, Job, Ledger

SETTINGS_PLACE = "conf/hydra/launcher or the command line"
STATE_COLOURS = {DONE_STATE: "green", FAILED_STATE: "red"}


class LedgerLauncher:
    """by: the function that runs jobs. finish: the one that makes table and page of a
    sweep's folder. retry: run those that failed again. warm_up_jobs: jobs that run before the
    others, so that machine code is compiled once, not by many at a time. variants:
    overrides by name; each job runs once for every variant, or only for the one that
    `name=` gives. settings: of the function `by`.
    """

    def __init__(
        self,
        by: str,
        finish: str,
        retry: bool,
        warm_up_jobs: int,
        variants: Mapping[str, Sequence[str]] | None = None,
        **settings: Any,
    ) -> None:
        """Take the settings unchecked; `setup` checks them, for Hydra hides what goes
        wrong here.
        """
        self.by, self.finish, self.retry, self.warm_up_jobs, self.settings = (
            by,
            finish,
            retry,
            warm_up_jobs,
            settings,
        )
        self.variants = variants or {}
        # the sweep's folder, what finishes it
        self.launched: tuple[Path, Callable[[Path], list[Job]]] | None = None

    def setup(
        self,
        *,
        hydra_context: HydraContext,
        task_function: TaskFunction,
        config: DictConfig,
    ) -> None:
        """Take what Hydra hands over before `launch`, and check the settings; raises
        UserError.
        """
        self.loader = hydra_context.config_loader
        self.config = config
        if (
            not isinstance(self.retry, bool)
            or type(self.warm_up_jobs) is not int
            or self.warm_up_jobs < 0
        ):
            wrong = f"retry = {self.retry!r}, warm_up_jobs = {self.warm_up_jobs!r}"
            raise UserError(
                f"hydra.launcher ({SETTINGS_PLACE}): {wrong}: give true or false, and a whole number from 0."
            )
        plain: Any = OmegaConf.to_container(OmegaConf.create(self.settings))
        self.launch_all = bind_stage(
            {"_target_": self.by} | plain, "hydra.launcher", SETTINGS_PLACE
        )

    def expand_variants(self, overrides: Sequence[str]) -> list[list[str]]:
        """Return the overrides of each variant of a job. Raises UserError."""
        if not self.variants:
            return [list(overrides)]
        named = [word for word in overrides if word.startswith("name=")]
        names = [word.removeprefix("name=") for word in named] or list(self.variants)
        if unknown := set(names) - set(self.variants):
            known = ", ".join(self.variants)
            raise UserError(
                f"name={unknown.pop()} (command line): there is no such experiment. "
                f"There are {known}."
            )
        others = [word for word in overrides if word not in named]
        return [[*others, f"name={name}", *self.variants[name]] for name in names]

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Run what is missing of these jobs. Each returns E after its last estimation,
        NaN if there is none.
        """
        ledger = Ledger(Path(self.config.hydra.sweep.dir).absolute())
        jobs = []
        variants = [one for job in job_overrides for one in self.expand_variants(job)]
        for number, overrides in enumerate(variants, start=initial_job_idx):
            # with its settings composed and resolved as its own run will
            config = self.loader.load_sweep_config(self.config, list(overrides))
            settings = OmegaConf.masked_copy(
                config, [str(name) for name in config if name != "hydra"]
            )
            plain: Any = OmegaConf.to_container(settings, resolve=True)
            jobs.append(Job(number, tuple(overrides), plain))
        for job in jobs:
            ledger.add(job)
        self.launched = (
            ledger.folder,
            load_callable(self.finish, "hydra.launcher.finish", SETTINGS_PLACE),
        )
        keys = [job.key for job in jobs]
        waiting = [
            Attempt(ledger.folder, key)
            for key in ledger.reset_unfinished(
                keys, (FAILED_STATE,) if self.retry else ()
            )
        ]
        first = (
            0
            if any(ledger.read(key).state == DONE_STATE for key in keys)
            else self.warm_up_jobs
        )
        console = Terminal(stderr=True)
        ended, begun, left_at_first = (
            len(keys) - len(waiting),
            time.monotonic(),
            len(waiting),
        )
        with progress_bars(console) as bar, bar("sweep") as progress:
            for batch in filter(None, (waiting[:first], waiting[first:])):
                for key in self.launch_all(batch):
                    ended += 1
                    progress(ended / len(keys))
                    said = remaining_time(
                        time.monotonic() - begun, len(keys) - ended, left_at_first
                    )
                    console.print(
                        job_line(ledger.read(key), said),
                        soft_wrap=True,
                        highlight=False,
                    )
        # not after an interruption, which is no failure
        ledger.mark_lost_as_failed(keys)
        return [job_return(ledger, job) for job in jobs]

    def finish_sweep(self) -> int:
        """Write table and page of the sweep, if it was begun, and say how it stands: 0
        if all its jobs are done.
        """
        if self.launched is None:
            return 0
        folder, finish = self.launched
        ledger = Ledger(folder)
        with ledger.lock_results():
            jobs = finish(folder)
        said = sweep_summary(jobs, folder, ledger.count_running_elsewhere(jobs))
        Terminal(stderr=True).print(said, soft_wrap=True, highlight=False, markup=False)
        return int(any(job.state != DONE_STATE for job in jobs))


def job_return(ledger: Ledger, job: Job) -> JobReturn:
    """The return values of jobs for a sweeper that optimises."""
    path = ledger.job_folder(job.key) / "run.json"
    rows = (
        json.loads(path.read_text(encoding="utf-8"))["iterations"]
        if path.exists()
        else []
    )
    rate = rows[-1].get("E_after") if rows else None
    result = JobReturn(overrides=list(job.overrides), status=JobStatus.COMPLETED)
    result.return_value = nan if rate is None else rate
    return result


def job_line(job: Job, left: str) -> Text:
    """A line about a job that ended, and about those left."""
    said = Text.assemble(
        (f"{job.state:<8}", STATE_COLOURS.get(job.state, "yellow")),
        f"{job.seconds:7.1f} s  ",
    )
    said.append(f"{' '.join(job.overrides)}  {left}")
    return (
        said.append(f"\n         {job.error.splitlines()[0]}", "red")
        if job.error
        else said
    )


def remaining_time(seconds: float, waiting: int, of: int) -> str:
    """The number of jobs that still wait, and the time that they take at the pace so
    far. seconds: since the first.
    """
    ahead = timedelta(seconds=round(seconds / max(of - waiting, 1) * waiting))
    return f"({waiting} left, about {ahead})" if waiting else ""


def sweep_summary(jobs: Sequence[Job], folder: Path, elsewhere: int) -> str:
    """Numbers of jobs by how they ended, and what to do about the others. elsewhere:
    how many another process is at.
    """
    count = Counter(job.state for job in jobs)
    left = len(jobs) - count[DONE_STATE] - count[FAILED_STATE] - elsewhere
    said = [f"{count[DONE_STATE]} of {len(jobs)} job(s) of the sweep are done."]
    again = f"the same command with hydra.sweep.dir={folder}"
    if elsewhere:
        said.append(
            f"{elsewhere} are run by another process, which completes the table when it ends; or {again} does."
        )
    if left:
        said.append(f"{left} did not end: give {again} to go on.")
    if count[FAILED_STATE]:
        said.append(
            f"{count[FAILED_STATE]} job(s) of the sweep failed: give {again} hydra.launcher.retry=true to try again."
        )
    return "\n".join([*said, str(folder / "report.html")])
