"""Punctuality: absolute deadlines, no garbage collection, real-time priority."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

SPIN_S = 0.001  # [s] before a moment from which the clock is watched closely


def wait_until(moment: float) -> None:
    """Sleep until a moment of time.monotonic [s].

    A sleep alone wakes up late, so that the end of it is a busy loop.
    """
    remaining = moment - time.monotonic() - SPIN_S
    if remaining > 0:
        time.sleep(remaining)
    while time.monotonic() < moment:
        pass


@contextmanager
def real_time_priority(priority: int) -> Iterator[None]:
    """Run the block without garbage collection and at real-time priority.

    The priority is SCHED_FIFO, 1 to 99, where the system allows it; 0: as usual.
    """
    was_collecting = gc.isenabled()
    former = None
    if priority and hasattr(os, "sched_setscheduler"):
        former = os.sched_getscheduler(0), os.sched_getparam(0)
    gc.disable()
    try:
        if former:
            # needs CAP_SYS_NICE or an rtprio limit; the record shows the jitter anyway
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        yield
    finally:
        if former:
            os.sched_setscheduler(0, *former)
        if was_collecting:
            gc.enable()
