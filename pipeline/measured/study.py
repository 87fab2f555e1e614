"""Every set of effects fitted to every string, each in a process of its own and kept as an ordinary run."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from omegaconf import OmegaConf
from pydantic import Field

from stringcast.data import store
from stringcast.pipeline.experiment import Experiment, prepare
from stringcast.pipeline.inherited import with_inherited_settings
from stringcast.pipeline.measured.family import Family
from stringcast.pipeline.measured.pictures import picture
from stringcast.pipeline.measured.scores import SETS, foretold, in_words, scored
from stringcast.pipeline.modes.stepwise import needs_trials
from stringcast.pipeline.modes.study import Study
from stringcast.pipeline.origin import origin, state
from stringcast.pipeline.run import perform
from stringcast.pipeline.settings import UserError, build, composed
from stringcast.pipeline.study.benches import workers
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.common import Progress

WHERE = "conf/experiment/measured_study.yaml"


@dataclass(frozen=True)
class Measured:
    """processes: 0 is one for each core. strings: names of those asked for, all if there are none."""

    processes: Annotated[int, Field(ge=0)]
    strings: list[str]
    families: dict[str, Family]


@dataclass(frozen=True)
class Job:
    """A set of effects and the string that it is fitted to."""

    family: str
    string: str
    laws: str

    def place(self, folder: Path) -> Path:
        """The folder of its run."""
        return folder / "fits" / f"{self.string}-{self.laws.replace(' ', '_')}"

    def kept(self, folder: Path) -> Path:
        """Where its row is."""
        return folder / "rows" / f"{self.place(folder).name}.json"


@dataclass(frozen=True)
class MeasuredStudy(Study):
    """Strings that others measured, fitted with stated sets of effects."""

    def check(self, experiment: Experiment) -> None:
        """As of `Mode`."""
        needs_trials(experiment)

    def run(self, experiment: Experiment, folder: Path, progress: Progress) -> str:
        """As of `Study`. What is in `folder` already is not made again."""
        return fitted(experiment, folder, progress)


def fitted(here: Experiment, folder: Path, progress: Progress) -> str:
    """Fit, tabulate and draw; what came out, in a sentence."""
    asked = build(Measured, here.config["measured"], "measured", WHERE)
    jobs = list(_jobs(asked, here.config, folder))
    failed = _all_made(jobs, here.config, folder, asked.processes, progress)
    rows = [json.loads(job.kept(folder).read_text(encoding="utf-8")) for job in jobs if job not in failed]
    table = SETS.check(pd.DataFrame(rows, columns=[column.name for column in SETS.columns]))
    store.write_table(SETS, table, folder / "sets.parquet", origin(here.config, "measured_study", here.seed, {}))
    held_out = {(job.string, job.laws): foretold(job.place(folder)) for job in jobs if job not in failed}
    picture(table, held_out, folder / "sets.png")
    return " ".join([in_words(table), *(f"Not fitted: {j.string}, {j.laws}: {why}." for j, why in failed.items())])


def _jobs(asked: Measured, config: Mapping[str, Any], folder: Path) -> Iterator[Job]:
    """All sets of all strings that are asked for, whose datasets are then there. Raises UserError for a string that is
    not."""
    source = Path(config["trials"])
    there = {name: family.strings(source) for name, family in asked.families.items()}
    known = [string for strings in there.values() for string in strings]
    if unknown := set(asked.strings) - set(known):
        raise UserError(f"measured.strings: there is no {', '.join(sorted(unknown))}; there are {', '.join(known)}.")
    made = origin({"measured": config["measured"], "trials": config["trials"]}, "dataset", 0, {})
    for name, family in asked.families.items():
        for string in (string for string in there[name] if not asked.strings or string in asked.strings):
            family.write(source, string, there[name][string], folder / "datasets" / string, made)
            yield from (Job(name, string, laws) for laws in family.sets)


def _all_made(
    jobs: list[Job], config: Mapping[str, Any], folder: Path, processes: int, progress: Progress
) -> dict[Job, str]:
    """Rows of every job on disk, but for those that failed, which are returned with the reason."""
    failed: dict[Job, str] = {}
    with workers(processes, lives=1) as pool:
        made = {pool.submit(make, job, config, folder): job for job in jobs if not job.kept(folder).exists()}
        for number, future in enumerate(as_completed(made)):
            if error := future.exception():
                failed[made[future]] = f"{type(error).__name__}: {error}"
            progress(1 - (len(made) - number - 1) / len(jobs))
    return failed


def make(job: Job, config: Mapping[str, Any], folder: Path) -> None:
    """Fit, in this process alone, and keep the row."""
    place = job.place(folder)
    whole = not (place / "iterations").exists()
    here = prepare(settings(job, config, folder / "datasets" / job.string), lambda block: f"conf/{block}")
    result = perform(here, place, Terminal(quiet=True))
    family = build(Family, config["measured"]["families"][job.family], f"measured.families.{job.family}", WHERE)
    names = {"string": job.string, "laws": job.laws, "effects": ", ".join(family.sets[job.laws]["effects"])}
    row = names | scored(here, result) | {"authors_tip": family.authors.get(job.string)}
    used = os.times()
    row |= {"cpu": used.user + used.system if whole else None, "code": state()[:7] + state()[40:]}
    store.write_text(job.kept(folder), json.dumps(row))


def settings(job: Job, config: Mapping[str, Any], dataset: Path) -> dict[str, Any]:
    """Of the run that a person begins by hand: +experiment=estimate trials=<dataset> and what the family sets."""
    family = config["measured"]["families"][job.family]
    own = composed(["+experiment=estimate"]) | family["settings"] | family["sets"][job.laws]
    own |= {"seed": config["seed"], "leave": [], "trials": str(dataset)}
    return with_inherited_settings(OmegaConf.create(own), {"string"})
