"""Collect what a run has made and write its report."""

from __future__ import annotations

from typing import Any

from stringcast.data.artifacts import Diagnosis
from stringcast.data.store import write_text
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.origin import PACKAGES, code, versions
from stringcast.pipeline.run import Result
from stringcast.stages.model.library import library
from stringcast.stages.report import Cast, Record, cast_record, report
from stringcast.stages.report.alignment import AlignmentRecord, alignment_report
from stringcast.stages.report.diagnosis import DiagnosisRecord, diagnosis_report


def write(experiment: Experiment, result: Result) -> None:
    """`report.html` in the run's folder."""
    if result.diagnosis is not None:
        write_text(result.folder / "report.html", diagnosis_report(_found(experiment, result.diagnosis)))
        return
    if result.alignment is not None:
        facts = (experiment.config["name"], result.sentence, result.alignment, experiment.config, made_by(experiment))
        write_text(result.folder / "report.html", alignment_report(AlignmentRecord(*facts)))
        return
    estimates = [i.done.get("estimate") for i in result.iterations]
    record = Record(
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
    write_text(result.folder / "report.html", report(record))


def _found(experiment: Experiment, diagnosis: Diagnosis) -> DiagnosisRecord:
    return DiagnosisRecord(
        experiment.config["name"], diagnosis, experiment.model, library(), experiment.config, made_by(experiment)
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
        made = (done["generate"], done["execute"], done["extract"], done.get("estimate"))
        casts.append(cast_record(experiment.model, iteration.observation, made, iteration.verdict, previous))
        previous = done.get("estimate", previous)
    return casts
