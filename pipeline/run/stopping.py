"""Ctrl-C while a stage works: the first asks it to end with what it knows, the next
ends the run at once.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

from stringcast.stages.common import InterruptRequest


@contextmanager
def stop_stage_on_interrupt() -> Iterator[None]:
    """Meanwhile a first SIGINT raises `Enough`; not where signals are ignored, or left
    to others, and not in threads, which receive none.
    """
    before = signal.getsignal(signal.SIGINT)

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, before)
        raise InterruptRequest

    if not callable(before) or current_thread() is not main_thread():
        yield
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
