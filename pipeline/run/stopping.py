"""The first Ctrl-C ends a stage with a preliminary result, the second ends the run."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Timer, current_thread, main_thread
from typing import TYPE_CHECKING

from stringcast.stages.common import InterruptRequest

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

REPEAT_AFTER_S = 0.05  # [s], longer than a callback


def repeat_ignored_interrupts() -> None:
    """Repeat every interrupt that Python ignored, from now on.

    Exceptions in finalizers and in callbacks from C are ignored. LLVM calls back after
    compiling a loop for seconds, and a Ctrl-C in that time would be lost.
    """
    former_hook = sys.unraisablehook

    def send_again(ignored: UnraisableHookArgs) -> None:
        if not issubclass(ignored.exc_type, KeyboardInterrupt):
            former_hook(ignored)
            return
        values = ignored.exc_value.args if ignored.exc_value else ()
        number = values[0] if values else signal.SIGINT
        timer = Timer(REPEAT_AFTER_S, signal.raise_signal, [number])
        timer.daemon = True
        with suppress(RuntimeError):  # Python is about to end
            timer.start()

    sys.unraisablehook = send_again


@contextmanager
def stop_stage_on_interrupt() -> Iterator[None]:
    """Raise `InterruptRequest` at the first SIGINT within the context.

    Does nothing outside the main thread, or if SIGINT is ignored or has another
    handler.
    """
    previous = signal.getsignal(signal.SIGINT)
    former_hook = sys.unraisablehook

    def stop(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, previous)
        raise InterruptRequest

    def await_repetition(ignored: UnraisableHookArgs) -> None:
        if ignored.exc_type is InterruptRequest:
            signal.signal(signal.SIGINT, stop)
        former_hook(ignored)

    if not callable(previous) or current_thread() is not main_thread():
        yield
        return
    signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = await_repetition
    try:
        yield
    finally:
        sys.unraisablehook = former_hook
        signal.signal(signal.SIGINT, previous)
