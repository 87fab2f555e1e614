"""The study of clocks: what seeds mean, and what its summary counts."""

from dataclasses import replace

import pandas as pd

from tests.benchmarks.clocks.recordings import Circumstances
from tests.benchmarks.clocks.study import ClocksStudy


def test_any_16_seeds_are_of_different_circumstances():
    for first in (0, 5, 16):
        seeds = range(first, first + 16)
        different = {replace(Circumstances.of_seed(seed), seed=0) for seed in seeds}
        assert len(different) == 16


def test_the_summary_counts_offsets_inside_and_refused_clocks():
    rows = pd.DataFrame(
        {
            "motion": ["cast", "cast", "slow"],
            "fps": [100.0, 100.0, 200.0],
            "hidden": [1.0, 2.0, 3.0],
            "found": [1.001, 2.1, 3.0],
            "low": [0.99, 2.05, 2.98],
            "high": [1.01, 2.15, 3.02],
            "is_refused": [True, False, True],
            "runtime": [5.0, 6.0, 7.0],
        }
    )
    summary = ClocksStudy().summary({"offsets": rows})
    assert "cast: 1 of 2 offsets inside" in summary
    assert "wrong clocks refused: 1 of 2" in summary
    assert "slow: 1 of 1 offsets inside; width 8.0 frames" in summary
    assert "processor time 6.0 s" in summary
