"""Collect what a run has made and write its report."""

from __future__ import annotations

from typing import Any

from stringcast.data.artifacts import Diagnosis
from stringcast.data.store import write_text
from stringcast.pipeline.origin import PACKAGES, code, versions
from stringcast.pipeline.run import Result
from stringcast.pipeline.world import World
from stringcast.stages.model.library import library
from stringcast.stages.report import Cast, Record, cast_record, report
from stringcast.stages.report.alignment import AlignmentRecord, alignment_report
from stringcast.stages.report.diagnosis import DiagnosisRecord, diagnosis_report


def write(world: World, result: Result) -> None:
    """`report.html` in the run's folder."""
    if result.diagnosis is not None:
        write_text(result.folder / "report.html", diagnosis_report(_found(world, result.diagnosis)))
        return
    if result.alignment is not None:
        facts = (world.config["name"], result.sentence, result.alignment, world.config, made_by(world))
        write_text(result.folder / "report.html", alignment_report(AlignmentRecord(*facts)))
        return
    estimates = [i.done.get("estimate") for i in result.iterations]
    record = Record(
        world.config["name"],
        result.sentence,
        result.hit,
        world.model,
        world.target,
        world.obstacles,
        tuple(_casts(world, result)),
        tuple(e for e in estimates if e is not None),
        world.config,
        made_by(world),
    )
    write_text(result.folder / "report.html", report(record))


def _found(world: World, diagnosis: Diagnosis) -> DiagnosisRecord:
    return DiagnosisRecord(world.config["name"], diagnosis, world.model, library(), world.config, made_by(world))


def made_by(world: World) -> dict[str, Any]:
    """What a page says it was made with."""
    return {"seed": world.seed, "code": code(), "packages": versions(PACKAGES)}


def _casts(world: World, result: Result) -> list[Cast]:
    """The casts of a run; none where only estimation ran."""
    casts = []
    previous = None
    for iteration in result.iterations:
        if iteration.verdict is None:
            return []
        done = iteration.done
        made = (done["generate"], done["execute"], done["extract"], done.get("estimate"))
        casts.append(cast_record(world.model, iteration.observation, made, iteration.verdict, previous))
        previous = done.get("estimate", previous)
    return casts
