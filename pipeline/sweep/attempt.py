"""One attempt at a job: the command that a person would give for it alone, in a process
of its own.

So a job that crashes or is killed takes nothing with it, and its numbers are those of a
single run, whoever starts it.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

from stringcast.hardware.arm.signals import TERMINATION_SIGNALS
from stringcast.pipeline.sweep.ledger import (
    DONE_STATE,
    FAILED_STATE,
    PENDING_STATE,
    RUNNING_STATE,
    Job,
    Ledger,
)

PIPELINE_COMMAND = (sys.executable, "-m", "stringcast")
INTERRUPT_STATUSES = {
    code for number in TERMINATION_SIGNALS for code in (128 + number, -number)
}
THREAD_VARIABLES = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)


@dataclass(frozen=True)
class Attempt:
    """The job `key` of the sweep in `folder`, to be called on whatever machine.

    command: what runs a job. place: where the sweep was begun, from which its settings
    name folders.
    """

    folder: Path
    key: str
    command: tuple[str, ...] = PIPELINE_COMMAND
    start_folder: Path = field(default_factory=Path.cwd)

    def __call__(self, threads: int) -> str:
        """Run the job, unless somebody is at it or it has ended, and enter how it
        ended. Returns its key.
        """
        ledger = Ledger(self.folder)
        with ledger.claim(self.key) as log:
            job = ledger.read(self.key)
            if log is not None and job.state in (PENDING_STATE, RUNNING_STATE):
                begun = replace(
                    job,
                    state=RUNNING_STATE,
                    error="",
                    attempts=job.attempts + 1,
                    host=socket.gethostname(),
                )
                ledger.write(begun)
                start, said = time.monotonic(), log.tell()
                code = self._run_process(job, log, threads)
                text = Path(log.name).read_bytes()[said:].decode(errors="replace")
                seconds = round(time.monotonic() - start, 3)
                state, error = job_ending(code, text)
                ledger.write(replace(begun, state=state, error=error, seconds=seconds))
        return self.key

    def _run_process(self, job: Job, log: BinaryIO, threads: int) -> int:
        """The exit status of the job's process, which inherits the log, and with it the
        lock.
        """
        escaped = str(self.folder / self.key).replace("'", "\\'")
        place = f"hydra.run.dir='{escaped}'"  # as Hydra's grammar takes any text
        return subprocess.run(
            [*self.command, *job.overrides, "hydra.mode=RUN", place],
            cwd=self.start_folder,
            env=os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads)),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            check=False,
        ).returncode


def job_ending(code: int, said: str) -> tuple[str, str]:
    """State and error of a job, from its exit status and what it said."""
    if code == 0:
        return DONE_STATE, ""
    if code in INTERRUPT_STATUSES:
        return PENDING_STATE, ""
    if code < 0:
        return (
            FAILED_STATE,
            f"Killed by {signal.Signals(-code).name}. Was there memory enough?",
        )
    return FAILED_STATE, error_message(said) or f"It ended with exit status {code}."


def error_message(said: str) -> str:
    """The error in what a process said: from the last line that begins with one on,
    else the last line.
    """
    lines = [line.rstrip() for line in said.splitlines() if line.strip()]
    begins = [number for number, line in enumerate(lines) if line.startswith("Error: ")]
    return "\n".join(lines[begins[-1] :] if begins else lines[-1:]).removeprefix(
        "Error: "
    )
