"""Launch a sweep for Hydra: keep the ledger and run the missing jobs.

Hydra's sweeper composes the jobs. Each becomes an entry of the ledger. The function in
`hydra.launcher.by` runs those that have not ended.
"""

from __future__ import annotations

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

from stringcast.pipeline.cli.console import progress_bar
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.typed_settings import bind_stage, load_callable
from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.ledger import DONE_STATE, FAILED_STATE, Job, Ledger

SETTINGS_PLACE = "conf/hydra/launcher or the command line"
STATE_COLOURS = {DONE_STATE: "green", FAILED_STATE: "red"}


class LedgerLauncher:
    """A Hydra launcher that records jobs in a ledger.

    Parameters
    ----------
    by : str
        Name of the function that runs jobs.
    finish : str
        Name of the function that writes table and page of a sweep.
    retry : bool
        Run failed jobs again.
    warm_up_jobs : int
        Jobs that run before the others to compile machine code once.
    variants : mapping of str to sequence of str, optional
        Overrides by name. Each job runs for every variant, or only for that of `name=`.
    settings : object
        Settings of the function `by`.
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
        """Store the settings; `setup` checks them, as Hydra hides errors here."""
        self.by = by
        self.finish = finish
        self.retry = retry
        self.warm_up_jobs = warm_up_jobs
        self.variants = variants or {}
        self.settings = settings
        # folder of the sweep, and function that finishes it
        self.launched: tuple[Path, Callable[[Path], list[Job]]] | None = None

    def setup(
        self,
        *,
        hydra_context: HydraContext,
        task_function: TaskFunction,
        config: DictConfig,
    ) -> None:
        """Store Hydra's objects for `launch`, and check the settings.

        Raises UserError for a setting with a wrong value.
        """
        self.loader = hydra_context.config_loader
        self.config = config
        where = f"hydra.launcher ({SETTINGS_PLACE})"
        if not isinstance(self.retry, bool):
            raise UserError(where, f"retry = {self.retry!r} must be true or false")
        if type(self.warm_up_jobs) is not int or self.warm_up_jobs < 0:
            fault = f"warm_up_jobs = {self.warm_up_jobs!r}"
            raise UserError(where, f"{fault} must be a whole number from 0")
        settings: Any = OmegaConf.to_container(OmegaConf.create(self.settings))
        chosen = {"_target_": self.by} | settings
        self.launch_all = bind_stage(chosen, "hydra.launcher", SETTINGS_PLACE)

    def expand_variants(self, overrides: Sequence[str]) -> list[list[str]]:
        """Return the overrides of each variant of a job, or raise UserError."""
        if not self.variants:
            return [list(overrides)]
        named = [word for word in overrides if word.startswith("name=")]
        names = [word.removeprefix("name=") for word in named] or list(self.variants)
        if unknown := set(names) - set(self.variants):
            known = ", ".join(self.variants)
            raise UserError(
                f"name={unknown.pop()} (command line)",
                "there is no such experiment",
                f"There are {known}.",
            )
        others = [word for word in overrides if word not in named]
        return [[*others, f"name={name}", *self.variants[name]] for name in names]

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Run the missing jobs and return the last matching rate E of each, or NaN."""
        finish = load_callable(self.finish, "hydra.launcher.finish", SETTINGS_PLACE)
        ledger = Ledger(Path(self.config.hydra.sweep.dir).absolute())
        jobs = self._compose_jobs(job_overrides, initial_job_idx)
        for job in jobs:
            ledger.add(job)
        self.launched = (ledger.folder, finish)

        keys = [job.key for job in jobs]
        states = (FAILED_STATE,) if self.retry else ()
        pending = ledger.reset_unfinished(keys, states)
        attempts = [Attempt(ledger.folder, key) for key in pending]
        is_new = all(ledger.read(key).state != DONE_STATE for key in keys)
        warm_up = self.warm_up_jobs if is_new else 0

        console = Terminal(stderr=True)
        start, ended = time.monotonic(), len(keys) - len(attempts)
        with progress_bar("sweep", console) as progress:
            for batch in filter(None, (attempts[:warm_up], attempts[warm_up:])):
                for key in self.launch_all(batch):
                    ended += 1
                    progress(ended / len(keys))
                    seconds = time.monotonic() - start
                    left = remaining_time(seconds, len(keys) - ended, len(attempts))
                    line = job_line(ledger.read(key), left)
                    console.print(line, soft_wrap=True, highlight=False)
        # skipped after an interruption, which is not a failure
        ledger.mark_lost_as_failed(keys)
        return [job_return(ledger, job) for job in jobs]

    def _compose_jobs(
        self, job_overrides: Sequence[Sequence[str]], first_number: int
    ) -> list[Job]:
        """Compose and resolve the settings of each job as in its own run."""
        all_overrides = []
        for overrides in job_overrides:
            all_overrides += self.expand_variants(overrides)
        jobs = []
        for number, overrides in enumerate(all_overrides, start=first_number):
            config = self.loader.load_sweep_config(self.config, overrides)
            names = [str(name) for name in config if name != "hydra"]
            own_config = OmegaConf.masked_copy(config, names)
            settings: Any = OmegaConf.to_container(own_config, resolve=True)
            jobs.append(Job(number, tuple(overrides), settings))
        return jobs

    def finish_sweep(self) -> int:
        """Write table and page of the sweep, if any, and print its state.

        Returns the exit status: 0 if all jobs are done.
        """
        if self.launched is None:
            return 0
        folder, finish = self.launched
        ledger = Ledger(folder)
        with ledger.lock_results():
            jobs = finish(folder)
        summary = sweep_summary(jobs, folder, ledger.count_running_elsewhere(jobs))
        Terminal(stderr=True).print_line(summary)
        return int(any(job.state != DONE_STATE for job in jobs))


def job_return(ledger: Ledger, job: Job) -> JobReturn:
    """Return the value of a job for a sweeper that optimises."""
    casts = ledger.casts(job.key)
    rate = casts[-1].get("E_after") if casts else None
    result = JobReturn(overrides=list(job.overrides), status=JobStatus.COMPLETED)
    result.return_value = nan if rate is None else rate
    return result


def job_line(job: Job, left: str) -> Text:
    """Return the line about an ended job, with the remaining time."""
    state = (f"{job.state:<8}", STATE_COLOURS.get(job.state, "yellow"))
    line = Text.assemble(state, f"{job.seconds:7.1f} s  ")
    line.append(f"{' '.join(job.overrides)}  {left}")
    if job.error:
        line.append(f"\n         {job.error.splitlines()[0]}", "red")
    return line


def remaining_time(seconds: float, waiting: int, of: int) -> str:
    """Describe the number of waiting jobs, of those at the start, and the time left.

    `seconds` is the time since the start.
    """
    time_left = timedelta(seconds=round(seconds / max(of - waiting, 1) * waiting))
    return f"({waiting} left, about {time_left})" if waiting else ""


def sweep_summary(jobs: Sequence[Job], folder: Path, elsewhere: int) -> str:
    """Return the number of jobs of a sweep by state, and how to continue.

    `elsewhere` is the number of jobs that another process is running.
    """
    count = Counter(job.state for job in jobs)
    left = len(jobs) - count[DONE_STATE] - count[FAILED_STATE] - elsewhere
    lines = [f"{count[DONE_STATE]} of {len(jobs)} job(s) of the sweep are done."]
    command = f"the same command with hydra.sweep.dir={folder}"
    if elsewhere:
        completion = "which completes the table when it ends"
        lines.append(f"{elsewhere} are run by another process, {completion}.")
    if left:
        lines.append(f"{left} did not end: give {command} to continue.")
    if failed := count[FAILED_STATE]:
        retry = f"give {command} hydra.launcher.retry=true to try again"
        lines.append(f"{failed} job(s) of the sweep failed: {retry}.")
    return "\n".join([*lines, str(folder / "report.html")])
