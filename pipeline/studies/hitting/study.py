"""The hit study: strings of the virtual bench, cast at targets in several ways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field

from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.pipeline.studies.engine import Study, StudyJob
from stringcast.pipeline.studies.hitting.job import casts_of
from stringcast.pipeline.studies.hitting.pictures import picture
from stringcast.pipeline.studies.hitting.scores import ALL, TABLES, scores

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class Lessons:
    """casts: how many. generate: settings of the stage that makes their motions.
    target: what they are cast at.
    """

    casts: Annotated[int, Field(ge=0)]
    generate: dict[str, Any]
    target: dict[str, Any]


@dataclass(frozen=True)
class Hits:
    """seeds: how many, from `first`; the same for all methods. lessons: casts that all
    learn from before theirs are counted. casts: these, at most. processes: 0 is one for
    each core. noise: of a measured coordinate, one sigma [m]. methods, cases: settings
    that differ; see `job.casts_of`.
    """

    seeds: Count
    first: Annotated[int, Field(ge=0)]
    lessons: Lessons
    casts: Count
    processes: Annotated[int, Field(ge=0)]
    noise: Annotated[float, Field(gt=0)]
    methods: dict[str, dict[str, Any]]
    cases: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class OneRun(StudyJob):
    """A case, a method, a seed. config: settings of the study."""

    case: str
    method: str
    seed: int
    config: Mapping[str, Any]

    @property
    def name(self) -> str:
        return f"{self.case}-{self.method}-{self.seed:04d}"

    def __call__(self) -> list[dict[str, Any]]:
        """A row for each cast."""
        hits = self.config["hits"]
        rows = casts_of(
            self.config,
            hits["cases"][self.case],
            hits["methods"][self.method],
            self.seed,
        )
        return [row | {"code": code_state()["commit"]} for row in rows]


@dataclass(frozen=True)
class HitStudy(Study):
    """Ways of casting, compared by how soon they hit."""

    KIND = "hit_study"
    TABLES = TABLES
    BLOCK, MORE = "hits", ("seeds", "first", "processes")

    def jobs(self, experiment: Experiment, folder: Path) -> list[OneRun]:
        """The jobs: for each seed all cases, each by all methods."""
        config = experiment.config
        asked = build_dataclass(
            Hits, config[self.BLOCK], self.BLOCK, "conf/experiment/hit_study.yaml"
        )
        seeds = range(asked.first, asked.first + asked.seeds)
        return [
            OneRun(case, way, seed, config)
            for seed in seeds
            for case in asked.cases
            for way in asked.methods
        ]

    def tables(
        self, experiment: Experiment, made: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        rows = [
            {"case": job.case, "method": job.method, "seed": job.seed, **row}
            for job, rows in made
            for row in rows
        ]
        return scores(pd.DataFrame(rows), experiment.config[self.BLOCK]["casts"])

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        picture(tables, folder / "hits.png")

    def sentence(self, tables: Mapping[str, pd.DataFrame]) -> str:
        rates = tables["rates"][tables["rates"]["case"] == ALL]
        said = []
        for method, some in rates.groupby("method", sort=False):
            shares = ", ".join(f"{100 * share:.0f} %" for share in some["share"])
            said.append(
                f"{method}: {shares} of {some['count'].iloc[0]} runs within 1 to {len(some)} casts"
            )
        codes = tables["casts"]["code"].nunique()
        pooled = (
            f" Runs are of {codes} states of the code: repeat the older."
            if codes > 1
            else ""
        )
        return f"Hit: {'; '.join(said)}.{pooled}"
