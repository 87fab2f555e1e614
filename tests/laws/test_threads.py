"""Parallel work in pieces.

Each piece is processed once, without waiting for a busy thread.
"""

import os
import threading

import numba
import numpy as np
import pytest
from conftest import threads

from stringcast.stages.model.engine.threads import _thread_pool, parallel_for

TWO = pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="needs two threads")


@TWO
@pytest.mark.parametrize(("count", "piece"), [(1, 1), (7, 1), (64, 10), (5, 100)])
def test_threads_process_each_piece_once(count, piece):
    done = np.zeros(count, int)

    def work(first, last):
        done[first:last] += 1

    with threads(2):
        parallel_for(work, count, piece)
    assert (done == 1).all()


@TWO
def test_a_thread_that_has_not_begun_is_cancelled():
    free, done = threading.Event(), []
    busy = _thread_pool(os.getpid(), 1).submit(free.wait, 30)
    with threads(2):
        parallel_for(lambda first, last: done.append(first), 8)
    assert done == [*range(8)]
    assert not busy.done()
    free.set()
    busy.result()


@TWO
def test_errors_in_a_thread_are_raised():
    begun = threading.Event()

    def work(first, last):
        if threading.current_thread() is threading.main_thread():
            assert begun.wait(30)
            return
        begun.set()
        raise ValueError("in a helper")

    with threads(2), pytest.raises(ValueError, match="in a helper"):
        parallel_for(work, 4)
