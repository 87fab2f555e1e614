"""End a stage with what it knows after a first Ctrl-C; end the run after a second."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

from stringcast.stages.common import InterruptRequest


@contextmanager
def stop_stage_on_interrupt() -> Iterator[None]:
    """Raise `InterruptRequest` at the first SIGINT for the duration of the context.

    Nothing changes if signals are ignored or handled by others, or outside the main
    thread, which alone receives them.
    """
    previous = signal.getsignal(signal.SIGINT)

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, previous)
        raise InterruptRequest

    if not callable(previous) or current_thread() is not main_thread():
        yield
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
