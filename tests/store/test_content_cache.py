"""The cache of results by the content of their inputs."""

import numpy as np

from stringcast.stages.content_cache import ContentCache


def test_cache_returns_recent_results_for_equal_arrays():
    cache = ContentCache(2)
    made = []

    def find(*numbers):
        def make():
            made.append(numbers)
            return sum(numbers)

        return cache.find_or_make([np.array(numbers)], make)

    assert [find(1.0, 2.0), find(3.0), find(1.0, 2.0)] == [3.0, 3.0, 3.0]
    assert made == [(1.0, 2.0), (3.0,)]
    find(4.0)  # (3.0,) was least recently used
    find(1.0, 2.0)
    find(3.0)
    assert made == [(1.0, 2.0), (3.0,), (4.0,), (3.0,)]
