"""Independent calls side by side in worker processes, with the results of one process.

A worker is a fork of this process: it has all that was computed so far, and only
results are sent back. Its lines of the log are written here, in the order of the calls.
Where a system has no safe fork, and within a worker, calls are made one after another.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import signal
import struct
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from logging.handlers import QueueHandler
from multiprocessing.connection import Connection, Pipe, wait
from queue import SimpleQueue
from typing import Any, TypeVar, cast

import numba

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")
# The number of a call as it waits in a pipe, which holds at least 4096 bytes
CALL_NUMBER = struct.Struct("=H")
MAX_CALLS = 4096 // CALL_NUMBER.size
CAN_FORK = hasattr(os, "fork") and sys.platform != "darwin"  # whose libraries forbid it
INTERRUPT_DELAY_S = 0.1  # at most, where another thread receives the signal
SET_SIGNAL_OF_PARENTS_DEATH = 1  # PR_SET_PDEATHSIG of Linux

_worker_count: ContextVar[int] = ContextVar("number of workers", default=0)


@dataclass(frozen=True)
class _Answer:
    """The result of a call, and the lines of the log that it wrote."""

    number: int
    result: Any
    log_records: Sequence[logging.LogRecord]


@contextmanager
def use_workers(count: int) -> Iterator[None]:
    """Use so many worker processes for the duration of the context.

    count: 0 for as many as Numba is set to use threads.
    """
    token = _worker_count.set(count)
    try:
        yield
    finally:
        _worker_count.reset(token)


def map_in_workers(
    function: Callable[[ItemT], ResultT], items: Sequence[ItemT]
) -> list[ResultT]:
    """Call a function of each item, several at a time, and return all results in order.

    Parameters
    ----------
    function : callable
        It must not depend on other calls. Its results are pickled.
    items : sequence
        It is fastest with the longest calls first.

    Returns
    -------
    list
    """
    count = min(_worker_count.get() or numba.get_num_threads(), len(items))
    if count < 2 or len(items) > MAX_CALLS or not CAN_FORK:
        return [function(item) for item in items]

    results: list[ResultT] = []
    answers: dict[int, _Answer] = {}
    with _start_workers(function, items, count) as readers:
        for answer in _receive_answers(readers):
            answers[answer.number] = answer
            while len(results) in answers:
                results.append(_accept(answers.pop(len(results))))

    # An error is raised again here, and what a killed worker has not done is done here
    for number in range(len(results), len(items)):
        if number in answers:
            results.append(_accept(answers[number]))
        else:
            results.append(function(items[number]))
    return results


def _accept(answer: _Answer) -> Any:
    """Write the log of a call, and return its result."""
    for record in answer.log_records:
        logging.getLogger(record.name).handle(record)
    return answer.result


@contextmanager
def _start_workers(
    function: Callable[[ItemT], ResultT], items: Sequence[ItemT], count: int
) -> Iterator[list[Connection]]:
    """Start workers, yield the ends of pipes on which they answer, and end them."""
    # Whoever is free reads the next number; nobody can add one, so that nobody waits
    numbers, numbers_in = os.pipe()
    for number in range(len(items)):
        os.write(numbers_in, CALL_NUMBER.pack(number))
    os.close(numbers_in)

    parent = os.getpid()
    readers: list[Connection] = []
    workers: list[int] = []
    # A worker that is interrupted before it ignores that would go on as this process
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with _defer_interruptions():
            for _ in range(count):
                reader, writer = Pipe(duplex=False)
                readers.append(reader)
                with writer, suppress(OSError):  # for lack of memory there are fewer
                    worker = os.fork()
                    if worker == 0:
                        _work(function, items, parent, numbers, readers, writer)
                    workers.append(worker)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield list(readers)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(numbers)
        for reader in readers:
            reader.close()
        for worker in workers:
            with suppress(OSError):  # where the system itself buries the dead
                os.kill(worker, signal.SIGKILL)
                os.waitpid(worker, 0)


@contextmanager
def _defer_interruptions() -> Iterator[None]:
    """Handle signals that interrupt at the end of the context.

    What their handlers raise while Python forks is lost: it ignores what its own
    callbacks there raise, such as those of the log. Another thread may have received a
    signal that this one blocks. Only the main thread handles signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    handlers = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):
            handlers[number] = signal.getsignal(number)
            signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for received_number in received:
        signal.raise_signal(received_number)


def _receive_answers(readers: list[Connection]) -> Iterator[_Answer]:
    """Yield answers as they come, until all workers have ended."""
    while readers:
        for ready in wait(readers, INTERRUPT_DELAY_S):
            reader = cast("Connection", ready)
            try:
                yield reader.recv()
            except EOFError:
                readers.remove(reader)


def _work(
    function: Callable[[ItemT], ResultT],
    items: Sequence[ItemT],
    parent: int,
    numbers: int,
    readers: Sequence[Connection],
    writer: Connection,
) -> None:
    """Answer calls until none is left, or one fails, and end this process."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if sys.platform == "linux":
            set_process_option = ctypes.CDLL(None).prctl
            set_process_option(SET_SIGNAL_OF_PARENTS_DEATH, signal.SIGKILL)
        for reader in readers:
            reader.close()
        gc.freeze()  # a collection would copy all pages of the parent's objects
        _worker_count.set(1)
        numba.set_num_threads(1)
        records = _collect_log_records()
        while os.getppid() == parent:
            number = os.read(numbers, CALL_NUMBER.size)
            if not number:
                break
            (index,) = CALL_NUMBER.unpack(number)
            result = function(items[index])
            written = [records.get() for _ in range(records.qsize())]
            writer.send(_Answer(index, result, written))
    finally:
        os._exit(0)


def _collect_log_records() -> SimpleQueue[logging.LogRecord]:
    """Collect all lines of the log from now on, and write none."""
    records: SimpleQueue[logging.LogRecord] = SimpleQueue()
    for name in (None, *logging.root.manager.loggerDict):
        logger = logging.getLogger(name)
        logger.handlers = []
        logger.propagate = name is not None
    logging.root.addHandler(QueueHandler(records))
    return records
