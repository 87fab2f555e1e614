"""Work in independent pieces, on as many threads as Numba is set to use.

It uses plain threads instead of `prange`. Numba's pools divide the work in advance and
wait for the slowest core, which on a busy machine took up to a hundred times as long as
one thread. Here each free thread, including the caller, takes the next piece. A thread
that has not begun is cancelled.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import numba

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])
# Decorator of kernels for threads: cached, and without the interpreter's lock.
compile_kernel: Callable[[FunctionT], FunctionT] = numba.njit(
    nogil=True, cache=True, error_model="numpy"
)

# With one piece each, waiting for a busy core costs as much as the thread saves.
MIN_PIECES_PER_THREAD = 2


def parallel_for(work: Callable[[int, int], None], count: int, piece: int = 1) -> None:
    """Call `work(first, last)` for pieces of `count` items, on several threads.

    Parameters
    ----------
    work : callable
        Processes items first to last - 1. Pieces must be independent, and `work` must
        release the interpreter's lock.
    count : int
        Number of items.
    piece : int
        Items in a piece. A piece should take about a millisecond or more, because the
        caller waits for an interrupted one.
    """
    threads = min(numba.get_num_threads(), count // piece // MIN_PIECES_PER_THREAD)
    if threads <= 1:
        work(0, count)
        return
    starts = iter(range(0, count, piece))  # shared: each thread takes the next one

    def take_pieces() -> None:
        for first in starts:
            work(first, min(first + piece, count))

    pool = _thread_pool(os.getpid(), threads - 1)
    helpers = [pool.submit(take_pieces) for _ in range(threads - 1)]
    take_pieces()
    for helper in helpers:
        if not helper.cancel():
            helper.result()


@cache
def _thread_pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Return the pool of this process, because threads do not survive a fork."""
    return ThreadPoolExecutor(threads, f"string-{process}")
