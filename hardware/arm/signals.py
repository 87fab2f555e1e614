"""A polite kill becomes an exception, so that the way out stops the arm."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | int | None
TERMINATION_SIGNALS = (signal.SIGINT, signal.SIGTERM) + (
    (signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()
)


class TerminationSignals:
    """While in force, SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt with the
    signal's number. Only the main thread receives signals; in another one this does
    nothing.
    """

    def __init__(self) -> None:
        """Nothing is in force yet."""
        self.before: dict[signal.Signals, Handler] = {}

    def install(self) -> None:
        """Handle polite signals from now on."""
        try:
            self.before = {
                number: signal.signal(number, _raise_interrupt)
                for number in TERMINATION_SIGNALS
            }
        except ValueError:
            self.before = {}

    def restore(self) -> None:
        """Restore the handlers of before."""
        for number, handler in self.before.items():
            signal.signal(number, handler)
        self.before = {}

    @contextmanager
    def ignore(self) -> Iterator[None]:
        """Nobody interrupts what is inside: an impatient second Ctrl-C must not prevent
        the stop.
        """
        for number in self.before:
            signal.signal(number, signal.SIG_IGN)
        try:
            yield
        finally:
            for number in self.before:
                signal.signal(number, _raise_interrupt)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)
