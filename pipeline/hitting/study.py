"""Every run of a hit study, each kept on disk as soon as it is there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field

from stringcast.data import store
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.hitting.job import casts_of
from stringcast.pipeline.hitting.pictures import picture
from stringcast.pipeline.hitting.scores import TABLES, scores, sentence
from stringcast.pipeline.modes.study import Study
from stringcast.pipeline.origin import origin, state
from stringcast.pipeline.settings import build
from stringcast.pipeline.study.benches import workers
from stringcast.stages.common import Progress

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class Lessons:
    """casts: how many. generate: settings of the stage that makes their motions. target: what they are cast at."""

    casts: Annotated[int, Field(ge=0)]
    generate: dict[str, Any]
    target: dict[str, Any]


@dataclass(frozen=True)
class Hits:
    """seeds: how many, from `first`; the same for all methods. lessons: casts that all learn from before theirs are
    counted. casts: these, at most. processes: 0 is one for each core. noise: of a measured coordinate, one sigma [m].
    methods, cases: settings that differ; see `job.casts_of`."""

    seeds: Count
    first: Annotated[int, Field(ge=0)]
    lessons: Lessons
    casts: Count
    processes: Annotated[int, Field(ge=0)]
    noise: Annotated[float, Field(gt=0)]
    methods: dict[str, dict[str, Any]]
    cases: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Job:
    """One run: a case, a method, a seed."""

    case: str
    method: str
    seed: int

    def kept(self, folder: Path) -> Path:
        """Where its rows are."""
        return folder / "rows" / f"{self.case}-{self.method}-{self.seed:04d}.json"


@dataclass(frozen=True)
class HitStudy(Study):
    """Ways of casting, compared by how soon they hit."""

    def run(self, experiment: Experiment, folder: Path, progress: Progress) -> str:
        """As of `Study`. What is in `folder` already is not made again."""
        return scored(experiment, folder, progress)


def scored(here: Experiment, folder: Path, progress: Progress) -> str:
    """Cast, count and draw; what came out, in a sentence."""
    asked = build(Hits, here.config["hits"], "hits", "conf/experiment/hit_study.yaml")
    seeds = range(asked.first, asked.first + asked.seeds)
    jobs = [Job(case, method, seed) for seed in seeds for case in asked.cases for method in asked.methods]
    _all_made(jobs, here.config, folder, asked.processes, progress)
    tables = scores(_table(jobs, folder), asked.casts)
    for name, frame in tables.items():
        store.write_table(TABLES[name], frame, folder / f"{name}.parquet", origin(here.config, "hit_study", 0, {}))
    picture(tables, folder / "hits.png")
    return sentence(tables)


def _all_made(jobs: list[Job], config: Mapping[str, Any], folder: Path, processes: int, progress: Progress) -> None:
    """Rows of every job on disk."""
    with workers(processes) as pool:
        made = [pool.submit(make, job, config, folder) for job in jobs if not job.kept(folder).exists()]
        for number, future in enumerate(as_completed(made)):
            future.result()
            progress(1 - (len(made) - number - 1) / len(jobs))


def make(job: Job, config: Mapping[str, Any], folder: Path) -> None:
    """Cast, and keep the rows."""
    hits = config["hits"]
    rows = casts_of(config, hits["cases"][job.case], hits["methods"][job.method], job.seed)
    store.write_text(job.kept(folder), json.dumps([row | {"code": state()} for row in rows]))


def _table(jobs: list[Job], folder: Path) -> pd.DataFrame:
    """A row for each cast of each job."""
    return pd.DataFrame(
        {"case": job.case, "method": job.method, "seed": job.seed, **row}
        for job in jobs
        for row in json.loads(job.kept(folder).read_text(encoding="utf-8"))
    )
