"""The ledger of a sweep: the state of every job, a file each, so that no kill and no
second sweep can spoil it.
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

from stringcast.data.schema import DataError
from stringcast.data.store import write_text

# [s] between looks at a lock that is waited for; making table and page takes about 1 s
LOCK_POLL_S = 0.1
PENDING_STATE, RUNNING_STATE, DONE_STATE, FAILED_STATE = (
    "pending",
    "running",
    "done",
    "failed",
)
LOST_WORKER_ERROR = (
    "The worker process died (killed, out of memory, time limit). See its log."
)


@dataclass(frozen=True)
class Job:
    """One run of a sweep.

    number: its place in the command that first asked for it. overrides: as Hydra takes
    them. settings: all, resolved. seconds, host: of the last attempt.
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
        """Hash of its settings."""
        return hashlib.sha256(
            json.dumps(self.settings, sort_keys=True).encode()
        ).hexdigest()[:12]


@dataclass(frozen=True)
class Ledger:
    """The jobs of the sweep in `folder`."""

    folder: Path

    def jobs(self) -> list[Job]:
        """All, in the order they were asked for; raises DataError naming a file that is
        damaged.
        """
        files = (self.folder / "ledger").glob("*.json")
        return sorted(
            (self.read(file.stem) for file in files),
            key=lambda job: (job.number, job.key),
        )

    def read(self, key: str) -> Job:
        """One job; raises DataError naming its file where that is missing or damaged."""
        path = self._job_file(key)
        try:
            known = json.loads(path.read_text(encoding="utf-8"))
            return Job(**known | {"overrides": tuple(known["overrides"])})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(
                f"{path}: not a job of a sweep ({error}). Delete it: the job is then run anew."
            ) from error

    def add(self, job: Job) -> None:
        """Enter a job, if it is not there."""
        if not self._job_file(job.key).exists():
            with self.claim(job.key) as log:
                if log is not None and not self._job_file(job.key).exists():
                    self.write(job)

    def write(self, job: Job) -> None:
        """Enter what has become of a job that is claimed, whole or not at all."""
        write_text(self._job_file(job.key), json.dumps(asdict(job), indent=1))

    @contextmanager
    def claim(self, key: str) -> Iterator[BinaryIO | None]:
        """The job's log, ours alone until it is closed here and in every process that
        inherited it; None if taken.
        """
        with open_for_lock(path := self._job_file(key).with_suffix(".log")) as log:
            yield log if try_lock(log, path) else None

    @contextmanager
    def lock_results(self) -> Iterator[None]:
        """Alone with what is made of the whole ledger; waits for others, so that the
        last one has seen it last.
        """
        with open_for_lock(path := self.folder / "ledger" / "finishing.lock") as file:
            while not try_lock(file, path):
                time.sleep(LOCK_POLL_S)
            yield

    def count_running_elsewhere(self, jobs: Sequence[Job]) -> int:
        """The number of these jobs that another process is running."""
        count = 0
        for job in (job for job in jobs if job.state == RUNNING_STATE):
            with self.claim(job.key) as log:
                count += log is None
        return count

    def reset_unfinished(self, keys: Sequence[str], states: Sequence[str]) -> list[str]:
        """The jobs that are to be run: those that never ended, or ended in one of
        `states`; entered as pending.
        """
        return [
            key
            for key in dict.fromkeys(keys)
            if self._change_state(key, (RUNNING_STATE, *states), PENDING_STATE)
        ]

    def mark_lost_as_failed(self, keys: Sequence[str]) -> None:
        """Enter as failed the jobs that were begun and that nobody is at any more."""
        for key in keys:
            self._change_state(key, (RUNNING_STATE,), FAILED_STATE, LOST_WORKER_ERROR)

    def job_folder(self, key: str) -> Path:
        """The folder of a job's run."""
        return self.folder / key

    def _change_state(
        self, key: str, states: Sequence[str], state: str, error: str = ""
    ) -> bool:
        """Put a job that nobody is at from one of `states` into `state`; whether it is
        in `state` now.

        It is claimed only where it must be, lest one who comes for it meanwhile finds
        it taken.
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
    """A file to be locked; raises DataError where it cannot be made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("ab")
    except OSError as error:
        raise DataError(
            f"{path}: cannot be written ({error.strerror}). Choose another hydra.sweep.dir."
        ) from error


def try_lock(file: BinaryIO, path: Path) -> bool:
    """Lock a file that is open, unless another has; raises DataError where the file
    system cannot lock.
    """
    if os.name != "posix":
        raise DataError(
            "A sweep needs a system that can lock files as POSIX does: Linux, macOS, or WSL on Windows."
        )
    import fcntl  # noqa: PLC0415 (not there on Windows, where all but sweeps works)

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        remedy = "Choose a hydra.sweep.dir on a file system that can lock files"
        raise DataError(
            f"{path}: cannot be locked ({error.strerror}). {remedy}."
        ) from error
    return True
