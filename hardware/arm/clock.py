"""Moments that are kept: absolute deadlines, no garbage collection, real-time priority
where it is allowed.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

SPIN_S = 0.001  # [s] before a moment from which the clock is watched closely


def wait_until(moment: float) -> None:
    """Sleep, then watch the clock: a sleep alone wakes up late. moment: of
    time.monotonic [s].
    """
    rest = moment - time.monotonic() - SPIN_S
    if rest > 0:
        time.sleep(rest)
    while time.monotonic() < moment:
        pass


@contextmanager
def real_time_priority(priority: int) -> Iterator[None]:
    """No garbage collection inside, and SCHED_FIFO at `priority` (1 to 99; 0: as usual)
    where the system allows it.
    """
    collecting, known = gc.isenabled(), priority and hasattr(os, "sched_setscheduler")
    before = (os.sched_getscheduler(0), os.sched_getparam(0)) if known else None
    gc.disable()
    try:
        if before:
            # needs CAP_SYS_NICE or an rtprio limit; the record tells the jitter anyway
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        yield
    finally:
        if before:
            os.sched_setscheduler(0, *before)
        if collecting:
            gc.enable()
