"""The state of every job of a sweep, one file each.

It survives kills and a second sweep in the same folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

from stringcast.data import disk
from stringcast.data.schema import DataError
from stringcast.data.store import write_text
from stringcast.pipeline.run.result import read_summary

LOCK_POLL_S = 0.1  # [s] between lock attempts; results take about 1 s
PENDING_STATE = "pending"
RUNNING_STATE = "running"
DONE_STATE = "done"
FAILED_STATE = "failed"
LOST_WORKER_ERROR = (
    "The worker process died (killed, out of memory, time limit). See its log."
)


@dataclass(frozen=True)
class Job:
    """A run of a sweep, and its state.

    Parameters
    ----------
    number : int
        Position in the command that first named it.
    overrides : tuple of str
        Words for Hydra's command line.
    settings : mapping
        All settings, resolved.
    state, error : str
        State, and reason of a failure.
    attempts : int
        Number of attempts.
    seconds, host : float, str
        Duration and machine of the last attempt.
    """

    number: int
    overrides: tuple[str, ...]
    settings: Mapping[str, Any] = field(repr=False)
    state: str = PENDING_STATE
    error: str = ""
    attempts: int = 0
    seconds: float = 0.0
    host: str = ""

    @property
    def key(self) -> str:
        """Hash of the settings."""
        text = json.dumps(self.settings, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Ledger:
    """Jobs of the sweep in a folder."""

    folder: Path

    def jobs(self) -> list[Job]:
        """Return all jobs in the order of their numbers.

        Raises DataError with the name of a damaged file.
        """
        files = (self.folder / "ledger").glob("*.json")
        jobs = [self.read(file.stem) for file in files]
        return sorted(jobs, key=lambda job: (job.number, job.key))

    def read(self, key: str) -> Job:
        """Read a job, or raise DataError that names its missing or damaged file."""
        path = self._job_file(key)
        try:
            fields = json.loads(path.read_text(encoding="utf-8"))
            return Job(**fields | {"overrides": tuple(fields["overrides"])})
        except (OSError, ValueError, KeyError, TypeError) as error:
            fault = f"{path}: not a job of a sweep ({error})"
            raise DataError("", fault, "Delete it to repeat the job.") from error

    def add(self, job: Job) -> None:
        """Add a job, unless it exists."""
        if not self._job_file(job.key).exists():
            with self.claim(job.key) as log:
                if log is not None and not self._job_file(job.key).exists():
                    self.write(job)

    def write(self, job: Job) -> None:
        """Write a claimed job atomically."""
        write_text(self._job_file(job.key), json.dumps(asdict(job), indent=1))

    @contextmanager
    def claim(self, key: str) -> Iterator[BinaryIO | None]:
        """Claim a job and open its log; yield None if it is claimed already.

        The claim ends when all processes that inherited the log have closed it.
        """
        with open_for_lock(path := self._job_file(key).with_suffix(".log")) as log:
            yield log if try_lock(log, path) else None

    @contextmanager
    def lock_results(self) -> Iterator[None]:
        """Wait for exclusive access to the files made from the whole ledger."""
        with open_for_lock(path := self.folder / "ledger" / "finishing.lock") as file:
            while not try_lock(file, path):
                time.sleep(LOCK_POLL_S)
            yield

    def count_running_elsewhere(self, jobs: Sequence[Job]) -> int:
        """Count the jobs that another process is running."""
        count = 0
        for job in jobs:
            if job.state == RUNNING_STATE:
                with self.claim(job.key) as log:
                    count += log is None
        return count

    def reset_unfinished(self, keys: Sequence[str], states: Sequence[str]) -> list[str]:
        """Mark jobs as pending that never ended, or ended in one of `states`.

        Returns the keys of all pending jobs among `keys`.
        """
        old_states = (RUNNING_STATE, *states)
        pending = []
        for key in dict.fromkeys(keys):
            if self._change_state(key, old_states, PENDING_STATE):
                pending.append(key)
        return pending

    def mark_lost_as_failed(self, keys: Sequence[str]) -> None:
        """Mark started jobs that no process runs as failed."""
        for key in keys:
            self._change_state(key, (RUNNING_STATE,), FAILED_STATE, LOST_WORKER_ERROR)

    def job_folder(self, key: str) -> Path:
        """Return the folder of a job's run."""
        return self.folder / key

    def casts(self, key: str) -> list[dict[str, Any]]:
        """Return the casts or estimations of a job's run from its run.json, if any."""
        return list(read_summary(self.job_folder(key)).get("iterations", []))

    def _change_state(
        self, key: str, states: Sequence[str], state: str, error: str = ""
    ) -> bool:
        """Change the state of an unclaimed job; return whether it has the new state.

        It is claimed only if necessary, so that a worker can claim it.
        """
        if self.read(key).state not in states:
            return self.read(key).state == state
        with self.claim(key) as log:
            job = self.read(key)
            if log is not None and job.state in states:
                job = replace(job, state=state, error=error)
                self.write(job)
            return job.state == state

    def _job_file(self, key: str) -> Path:
        return self.folder / "ledger" / f"{key}.json"


def open_for_lock(path: Path) -> BinaryIO:
    """Open a file for locking, or raise DataError if it cannot be made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("ab")
    except OSError as error:
        fault = f"{path}: cannot be written ({error.strerror})"
        raise DataError("", fault, "Choose another hydra.sweep.dir.") from error


def try_lock(file: BinaryIO, path: Path) -> bool:
    """Lock an open file, and return False if another process has locked it.

    Raises DataError if the system or the file system cannot lock files.
    """
    if os.name != "posix":
        raise DataError(
            "",
            "A sweep needs POSIX file locks",
            "Use Linux, macOS, or WSL on Windows.",
        )
    try:
        disk.lock_file(file)
    except BlockingIOError:
        return False
    except OSError as error:
        remedy = "Choose a hydra.sweep.dir on a file system that can lock files"
        fault = f"{path}: cannot be locked ({error.strerror})"
        raise DataError("", fault, f"{remedy}.") from error
    return True
