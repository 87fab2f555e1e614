"""The casting studies.

Several methods cast strings of the virtual lab at targets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field

from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.typed_settings import build_dataclass
from tests.benchmarks.casting.pictures import draw_hits
from tests.benchmarks.casting.runs import run_casts
from tests.benchmarks.casting.scores import ALL_CASES, TABLES, score_casts
from tests.benchmarks.study import Config, Study, StudyJob

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class TrainingCasts:
    """The training casts of a run.

    `casts` is their number, `generate` holds the settings of the stage that plans them,
    and `target` is their target.
    """

    casts: Annotated[int, Field(ge=0)]
    generate: dict[str, Any]
    target: dict[str, Any]


@dataclass(frozen=True)
class CastingSettings:
    """Settings of a casting study.

    `seeds` is the number of seeds from `first`, the same for all methods. `casts` is
    the largest number of casts in a run. `processes` is 0 for one per core. `noise` is
    the standard deviation of a measured coordinate [m]. `methods` and `cases` change
    settings.
    """

    seeds: Count
    first: Annotated[int, Field(ge=0)]
    training: TrainingCasts
    casts: Count
    processes: Annotated[int, Field(ge=0)]
    noise: Annotated[float, Field(gt=0)]
    methods: dict[str, dict[str, Any]]
    cases: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class RunJob(StudyJob):
    """A case, a method and a seed.

    `config` holds the settings of the study.
    """

    case: str
    method: str
    seed: int
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name of the result file."""
        return f"{self.case}-{self.method}-{self.seed:04d}"

    def __call__(self) -> list[dict[str, Any]]:
        """Return a row for each cast."""
        study = self.config["casting"]
        rows = run_casts(
            self.config,
            study["cases"][self.case],
            study["methods"][self.method],
            self.seed,
        )
        return [row | {"code": code_state()["commit"]} for row in rows]


@dataclass(frozen=True)
class CastingStudy(Study):
    """Methods of casting, compared by how many casts they need."""

    TABLES = TABLES
    BLOCK, GROWING = "casting", ("seeds", "first", "processes")

    def jobs(self, config: Config, folder: Path) -> list[RunJob]:
        """Return the jobs: for each seed all cases, each with all methods."""
        settings = build_dataclass(
            CastingSettings,
            config[self.BLOCK],
            self.BLOCK,
            "tests/benchmarks/conf/study",
        )
        jobs = []
        for seed in range(settings.first, settings.first + settings.seeds):
            for case in settings.cases:
                jobs += [
                    RunJob(case, method, seed, config) for method in settings.methods
                ]
        return jobs

    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return table CASTS and the tables counted from it."""
        rows = []
        for job, casts in results:
            rows += [
                {"case": job.case, "method": job.method, "seed": job.seed, **cast}
                for cast in casts
            ]
        return score_casts(pd.DataFrame(rows), config[self.BLOCK]["casts"])

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Write hits.png."""
        draw_hits(tables, folder / "hits.png")

    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return the shares of runs that have hit, by method."""
        rates = tables["rates"][tables["rates"]["case"] == ALL_CASES]
        parts = []
        for method, rows in rates.groupby("method", sort=False):
            shares = ", ".join(f"{100 * share:.0f} %" for share in rows["share"])
            parts.append(
                f"{method}: {shares} of {rows['count'].iloc[0]} runs within 1 to {len(rows)} casts"
            )
        commits = tables["casts"]["code"].nunique()
        warning = (
            f" The runs were made by {commits} versions of the code."
            if commits > 1
            else ""
        )
        return f"Hit: {'; '.join(parts)}.{warning}"
