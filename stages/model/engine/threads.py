"""Work in independent pieces, on as many threads as Numba is set to use.

Threads of our own and no `prange`: Numba's pools share work out before it begins and
wait for the slowest core, which on a busy machine took up to a hundred times what one
thread takes. Here a piece is begun by whoever is free, the caller among them, and a
thread that has not come to begin is not waited for.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numba

# pieces for each thread: with one each, on a busy machine, to wait for the other's
# costs what it saves
MIN_PIECES_PER_THREAD = 2


def parallel_for(work: Callable[[int, int], None], count: int, piece: int = 1) -> None:
    """Do `count` things, `piece` of them at a time: work(first, last) does those from
    first to before last.

    What it does must not depend on who else does what, and hold no lock of the
    interpreter. A piece is worth a thread from about a millisecond: one that is taken
    off its core in the middle of a piece is waited for.
    """
    threads = min(numba.get_num_threads(), count // piece // MIN_PIECES_PER_THREAD)
    if threads <= 1:
        work(0, count)
        return
    ahead = iter(range(0, count, piece))  # which gives each to one thread

    def take() -> None:
        for first in ahead:
            work(first, min(first + piece, count))

    helpers = [
        _thread_pool(os.getpid(), threads - 1).submit(take) for _ in range(threads - 1)
    ]
    take()
    for helper in helpers:
        if not helper.cancel():
            helper.result()


@cache
def _thread_pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Threads of this process: those of a process do not live on in its forks."""
    return ThreadPoolExecutor(threads, f"string-{process}")
