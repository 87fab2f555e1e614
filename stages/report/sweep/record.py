"""What the page of a sweep is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from stringcast.stages.report.sweep.outcomes import OUTCOMES, Outcome, parameter

SEED = "seed"


@dataclass(frozen=True)
class SweepRecord:
    """table: a row a job, see `pipeline.sweep.table`. given: its columns that are settings. estimated: unit and meaning
    of its columns that are parameters, by name. settings: those that all jobs have in common."""

    name: str
    sentence: str
    table: pd.DataFrame = field(repr=False)
    given: Sequence[str]
    estimated: Mapping[str, tuple[str, str]]
    settings: Mapping[str, Any] = field(repr=False)
    origin: Mapping[str, Any] = field(repr=False)

    @cached_property
    def done(self) -> pd.DataFrame:
        """The jobs that ran to their end, each with a seed."""
        done = self.table[self.table["state"] == "done"]
        return done if SEED in done else done.assign(**{SEED: 0})

    @cached_property
    def failed(self) -> pd.DataFrame:
        """The jobs that failed."""
        return self.table[self.table["state"] == "failed"]

    @cached_property
    def factors(self) -> tuple[str, ...]:
        """The settings that were varied, but for the seed, whose values only repeat the experiment."""
        return tuple(name for name in self.given if name != SEED and self.table[name].nunique() > 1)

    @cached_property
    def outcomes(self) -> tuple[Outcome, ...]:
        """What is known of at least one job."""
        every = (*OUTCOMES, *(parameter(name, *words) for name, words in self.estimated.items()))
        return tuple(outcome for outcome in every if self.done[outcome.name].notna().any())

    @property
    def seeds(self) -> int:
        """How many seeds there are among the jobs that ended."""
        return int(self.done[SEED].nunique())
