"""Punctuality: absolute deadlines, no garbage collection, real-time priority."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

SPIN_S = 0.001  # [s] of busy waiting before a deadline


def wait_until(moment: float) -> None:
    """Sleep until a moment of time.monotonic [s], with a busy loop at the end."""
    remaining = moment - time.monotonic() - SPIN_S
    if remaining > 0:
        time.sleep(remaining)
    while time.monotonic() < moment:
        pass


@contextmanager
def real_time_priority(priority: int) -> Iterator[None]:
    """Run the block without garbage collection and at real-time priority.

    The priority is SCHED_FIFO, 1 to 99, if the system allows it; 0: normal.
    """
    was_collecting = gc.isenabled()
    former = None
    if priority and hasattr(os, "sched_setscheduler"):
        former = os.sched_getscheduler(0), os.sched_getparam(0)
    gc.disable()
    try:
        if former:
            # needs CAP_SYS_NICE or an rtprio limit; without it, the record shows the
            # jitter
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        yield
    finally:
        if former:
            os.sched_setscheduler(0, *former)
        if was_collecting:
            gc.enable()
