"""Run one job of a sweep as a single run in its own process.

A crashed or killed job does not stop others. The results equal those of a single run
for every launcher.
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
    """A job of a sweep that can be called on any machine.

    Parameters
    ----------
    folder : Path
        Folder of the sweep.
    key : str
        Key of the job.
    command : tuple of str
        Command that runs a job.
    start_folder : Path
        Working directory of the sweep; paths in settings are relative to it.
    """

    folder: Path
    key: str
    command: tuple[str, ...] = PIPELINE_COMMAND
    start_folder: Path = field(default_factory=Path.cwd)

    def __call__(self, threads: int) -> str:
        """Run the job unless it is claimed or has ended; record it; return its key."""
        ledger = Ledger(self.folder)
        with ledger.claim(self.key) as log:
            job = ledger.read(self.key)
            if log is None or job.state not in (PENDING_STATE, RUNNING_STATE):
                return self.key
            running = replace(
                job,
                state=RUNNING_STATE,
                error="",
                attempts=job.attempts + 1,
                host=socket.gethostname(),
            )
            ledger.write(running)
            start, log_start = time.monotonic(), log.tell()
            status = self._run_process(job, log, threads)
            output = Path(log.name).read_bytes()[log_start:].decode(errors="replace")
            seconds = round(time.monotonic() - start, 3)
            state, error = job_ending(status, output)
            ledger.write(replace(running, state=state, error=error, seconds=seconds))
        return self.key

    def _run_process(self, job: Job, log: BinaryIO, threads: int) -> int:
        """Return the status of the job's process, which inherits the log's lock."""
        escaped = str(self.folder / self.key).replace("'", "\\'")
        folder = f"hydra.run.dir='{escaped}'"  # Hydra's grammar accepts any quoted text
        return subprocess.run(
            [*self.command, *job.overrides, "hydra.mode=RUN", folder],
            cwd=self.start_folder,
            env=os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads)),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            check=False,
        ).returncode


def job_ending(status: int, output: str) -> tuple[str, str]:
    """Return state and error of a job from its exit status and output."""
    if status == 0:
        return DONE_STATE, ""
    if status in INTERRUPT_STATUSES:
        return PENDING_STATE, ""
    if status < 0:
        name = signal.Signals(-status).name
        return FAILED_STATE, f"Killed by {name}, perhaps for lack of memory."
    return FAILED_STATE, error_message(output) or f"It ended with exit status {status}."


def error_message(output: str) -> str:
    """Return the last error in the output of a process, or else its last line."""
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    starts = [number for number, line in enumerate(lines) if line.startswith("Error: ")]
    message = lines[starts[-1] :] if starts else lines[-1:]
    return "\n".join(message).removeprefix("Error: ")
