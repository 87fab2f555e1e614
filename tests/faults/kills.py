"""Kill real processes at random moments with SIGKILL.

The run is continued to its end, and its result is compared.
"""

import os
import signal
import time

import numpy as np

from tests.faults.strike import look_at_what_is_left
from tests.faults.toy import contents, toy_run


class Forked:
    """A run of toy stages in a child process."""

    def __init__(self, here):
        self.here = here

    def start(self, folder):
        child = os.fork()
        if child == 0:
            code = 1
            try:
                toy_run(folder, self.here)
                code = 0
            finally:
                os._exit(code)
        return child

    def ended(self, child):
        """Return the exit status, or None while it runs."""
        pid, status = os.waitpid(child, os.WNOHANG)
        return None if pid == 0 else os.waitstatus_to_exitcode(status)

    def kill(self, child):
        os.kill(child, signal.SIGKILL)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def ended_by(run, process, moment):
    """Let a process run until a moment [s] after now, then kill it.

    Returns its exit status.
    """
    until = time.monotonic() + moment
    while (status := run.ended(process)) is None and time.monotonic() < until:
        time.sleep(0.002)
    return run.kill(process) if status is None else status


def round_of(run, folder, whole, rng, span):
    """Kill a run repeatedly until it ends; return a row for each process.

    span: duration of a whole run [s]. Each process may last slightly longer than the
    previous one.
    """
    rows = []
    status = None
    while status != 0:
        moment = rng.uniform(0, span * (1 + len(rows)) / 4)
        status = ended_by(run, run.start(folder), moment)
        assert status in (0, -signal.SIGKILL), f"it failed by itself: {status}"
        look_at_what_is_left(folder, whole)
        steps = len(list(folder.glob("iterations/*/*/")))
        rows.append(
            {"life": len(rows), "moment": moment, "killed": status != 0, "steps": steps}
        )
    assert contents(folder) == whole, "the result is another than the uninterrupted one"
    return rows


def rounds(run, folder, seed, numbers):
    """Run rounds in separate folders, after timing an uninterrupted run."""
    rng = np.random.default_rng(seed)
    begun = time.monotonic()
    assert ended_by(run, run.start(folder / "whole"), 600) == 0
    span = time.monotonic() - begun
    whole = contents(folder / "whole")
    return [
        {"seed": seed, "round": n} | row
        for n in numbers
        for row in round_of(run, folder / str(n), whole, rng, span)
    ]
