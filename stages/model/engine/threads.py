"""Work in independent pieces, on as many threads as Numba is set to use.

These are plain threads and no `prange`: Numba's pools share work out before it begins
and wait for the slowest core, which on a busy machine took up to a hundred times what
one thread takes. Here whoever is free begins a piece, the caller among them, and a
thread that has not begun is not waited for.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import numba

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])
# Decorates a kernel for threads: compiled once, it holds no lock of the interpreter.
compile_kernel: Callable[[FunctionT], FunctionT] = numba.njit(
    nogil=True, cache=True, error_model="numpy"
)

# With one piece each, on a busy machine, waiting for the other's costs what it saves.
MIN_PIECES_PER_THREAD = 2


def parallel_for(work: Callable[[int, int], None], count: int, piece: int = 1) -> None:
    """Call `work(first, last)` for pieces of `count` things, on several threads.

    Parameters
    ----------
    work : callable
        Does the things from first to before last. It must not depend on who else does
        what, and hold no lock of the interpreter.
    count : int
        Number of things.
    piece : int
        Things in a piece. A piece is worth a thread from about a millisecond: one that
        is taken off its core in the middle of a piece is waited for.
    """
    threads = min(numba.get_num_threads(), count // piece // MIN_PIECES_PER_THREAD)
    if threads <= 1:
        work(0, count)
        return
    starts = iter(range(0, count, piece))  # shared: it gives each start to one thread

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
    """Return threads of this process: threads do not live on in its forks."""
    return ThreadPoolExecutor(threads, f"string-{process}")
