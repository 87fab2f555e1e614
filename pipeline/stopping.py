"""Ctrl-C while a stage works: the first asks it to end with what it knows, the next ends the run at once."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from stringcast.stages.common import Enough


@contextmanager
def stoppable() -> Iterator[Callable[[], bool]]:
    """Meanwhile a first SIGINT raises `Enough`; gives what tells whether there was one. Only the main thread receives
    signals: in another one this does nothing."""
    before, asked = signal.getsignal(signal.SIGINT), list[int]()

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, before)
        asked.append(number)
        raise Enough

    with suppress(ValueError):
        signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: bool(asked)
    finally:
        with suppress(ValueError):
            signal.signal(signal.SIGINT, before)
