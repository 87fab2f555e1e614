"""Collect what a run has made and write its report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.utils import get_object

from stringcast.data.store import write_text
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.origin import PACKAGES, code, versions
from stringcast.pipeline.result import Result
from stringcast.stages.report.pages.cast import cast_page
from stringcast.stages.report.records import Cast, Facts, Record, cast_record
from stringcast.stages.spec import StageSpec


def write(experiment: Experiment, result: Result) -> None:
    """`report.html` in the run's folder: the page of the stage that the run was for, or that of its casts."""
    if result.stage is not None:
        write_page(experiment, result.stage, result.answer, result.sentence, result.folder)
    else:
        write_text(result.folder / "report.html", cast_page(casting(experiment, result)))


def write_page(experiment: Experiment, stage: StageSpec, made: Any, sentence: str, folder: Path) -> None:
    """The page of a stage. made: its artifact."""
    name, config = experiment.config["name"], experiment.config
    facts = Facts(name, sentence, made, experiment.model, config, made_by(experiment))
    write_text(folder / "report.html", get_object(f"stringcast.{stage.page}")(facts))


def casting(experiment: Experiment, result: Result) -> Record:
    """What the page of casts is made from."""
    estimates = [i.done.get("estimate") for i in result.iterations]
    return Record(
        experiment.config["name"],
        result.sentence,
        result.hit,
        experiment.model,
        experiment.target,
        experiment.obstacles,
        tuple(_casts(experiment, result)),
        tuple(e for e in estimates if e is not None),
        experiment.config,
        made_by(experiment),
    )


def made_by(experiment: Experiment) -> dict[str, Any]:
    """What a page says it was made with."""
    return {"seed": experiment.seed, "code": code(), "packages": versions(PACKAGES)}


def _casts(experiment: Experiment, result: Result) -> list[Cast]:
    """The casts of a run; none where only estimation ran."""
    casts = []
    previous = None
    for iteration in result.iterations:
        if iteration.verdict is None:
            return []
        done = iteration.done
        made = (done["motion"], done["trial"], done["points"], done.get("estimate"))
        casts.append(cast_record(experiment.model, iteration.observation, made, iteration.verdict, previous))
        previous = done.get("estimate", previous)
    return casts
