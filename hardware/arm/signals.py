"""Termination signals as exceptions, so that leaving the program stops the arm."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | int | None
TERMINATION_SIGNALS = [signal.SIGINT, signal.SIGTERM]
if hasattr(signal, "SIGHUP"):
    TERMINATION_SIGNALS.append(signal.SIGHUP)


class TerminationSignals:
    """Handlers that raise KeyboardInterrupt for SIGINT, SIGTERM and SIGHUP.

    The exception holds the signal's number. In threads other than the main thread they
    do nothing.
    """

    def __init__(self) -> None:
        self.former_handlers: dict[signal.Signals, Handler] = {}

    def install(self) -> None:
        """Install the signal handlers."""
        with suppress(ValueError):
            self.former_handlers = {
                number: signal.signal(number, _raise_interrupt)
                for number in TERMINATION_SIGNALS
            }

    def restore(self) -> None:
        """Restore the former handlers."""
        for number, handler in self.former_handlers.items():
            signal.signal(number, handler)
        self.former_handlers = {}

    @contextmanager
    def ignore(self) -> Iterator[None]:
        """Ignore the signals inside the block.

        A second Ctrl-C must not prevent the stop.
        """
        for number in self.former_handlers:
            signal.signal(number, signal.SIG_IGN)
        try:
            yield
        finally:
            for number in self.former_handlers:
                signal.signal(number, _raise_interrupt)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)
