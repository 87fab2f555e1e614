"""Collect the results of a run and write its report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stringcast.data.artifacts import Motion, Points, Trial
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Surprise
from stringcast.data.store import write_text
from stringcast.pipeline.cli.terminal import program_name
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Iteration
from stringcast.pipeline.run.provenance import software_versions
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import Settings
from stringcast.stages.hit_test import HitResult
from stringcast.stages.model.model import Model
from stringcast.stages.plugins import load_object
from stringcast.stages.report.pages.cast import cast_page
from stringcast.stages.report.parts import FOLDER_PLACEHOLDER as HERE
from stringcast.stages.report.records import (
    CastRecord,
    RunRecord,
    StageRecord,
    simulate_cast,
)
from stringcast.stages.spec import StageSpec


def write_report(experiment: Experiment, result: RunResult) -> None:
    """Write `report.html` of a run: the page of a stage or of casts."""
    if result.stage is None:
        page = cast_page(collect_casts(experiment, result))
        write_text(result.folder / "report.html", page)
        return
    artifact = result.final_artifact
    write_stage_page(experiment, result.stage, artifact, result.sentence, result.folder)


def write_stage_page(
    experiment: Experiment, stage: StageSpec, artifact: Any, sentence: str, folder: Path
) -> None:
    """Write `report.html` in a folder: the page of a stage's artifact."""
    commands = []
    if stage.name == "diagnose":
        commands = commands_after_diagnosis(artifact, experiment.config)
    record = StageRecord(
        experiment.config["name"],
        sentence,
        artifact,
        experiment.model,
        experiment.config,
        page_provenance(experiment),
        next_commands(commands),
    )
    make_page = load_object(stage.page)
    write_text(folder / "report.html", make_page(record))


def collect_casts(experiment: Experiment, result: RunResult) -> RunRecord:
    """Collect the data of the page of casts."""
    look: CastRecord | None = None
    casts = []
    estimates = []
    previous: Estimate | None = None
    for iteration in result.iterations:
        estimate = iteration.find(Estimate)
        if estimate is not None:
            estimates.append(estimate)
        if iteration.is_look:
            look = collect_cast(experiment.model, iteration, previous)
        elif iteration.verdict is not None:
            casts.append(collect_cast(experiment.model, iteration, previous))
        else:
            continue  # only estimated
        if estimate is not None:
            previous = estimate
    return RunRecord(
        name=experiment.config["name"],
        sentence=result.sentence,
        hit=result.has_hit,
        model=experiment.model,
        target=experiment.target,
        obstacles=experiment.obstacles,
        casts=tuple(casts),
        estimates=tuple(estimates),
        settings=experiment.config,
        provenance=page_provenance(experiment),
        next_commands=next_commands(commands_after_casts(result)),
        look=look,
    )


def collect_cast(
    model: Model, iteration: Iteration, previous: Estimate | None
) -> CastRecord:
    """Collect the data of a cast, or of the look before the first.

    `previous` is the estimate that was used to generate the motion.
    """
    motion, trial = iteration.find(Motion), iteration.find(Trial)
    points, estimate = iteration.find(Points), iteration.find(Estimate)
    assert motion is not None
    assert trial is not None
    assert points is not None
    observation = iteration.observe(trial, points)
    before, after = simulate_cast(model, observation, trial, previous, estimate)
    return CastRecord(
        motion,
        trial,
        points,
        estimate,
        verdict=iteration.verdict or HitResult.unknown(),
        before=before,
        after=after,
        surprise=iteration.find(Surprise),
    )


def next_commands(commands: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return purpose and text of the commands offered on a page.

    `commands` holds purpose and arguments of each.
    """
    verify = ("Compute every step again and compare bit by bit", f"verify {HERE}")
    shown = [*commands, verify]
    return [(purpose, f"{program_name()} {words}") for purpose, words in shown]


def commands_after_casts(result: RunResult) -> list[tuple[str, str]]:
    """Return the commands to offer after casts, or after estimation alone."""
    commands = []
    if not all(iteration.refusal_reason for iteration in result.iterations):
        purpose = "What does the simulation get wrong in these trials, and why?"
        commands.append((purpose, f"+experiment=diagnose trials={HERE}"))
    estimate = result.last_estimate
    if estimate is not None and estimate.parameters["low"].isna().all():
        words = f"+experiment=estimate estimate=least_squares trials={HERE}"
        purpose = "Estimate the string from the same trials, with intervals"
        commands.append((purpose, words))
    if estimate is not None:
        purpose = "A table of the string's parameters, with units"
        commands.append((purpose, f"export {HERE} string.csv"))
    return commands


def commands_after_diagnosis(
    diagnosis: Diagnosis, config: Settings
) -> list[tuple[str, str]]:
    """Return the commands to offer after a diagnosis, by its verdict."""
    trials = f"trials={config['trials']}"
    check = (
        "Check the measurements: what is usable, what looks wrong",
        f"check {config['trials']}",
    )
    decide = (
        "Perform the motion that distinguishes the candidate causes",
        f"+experiment=decide {trials}",
    )
    cast = ("Cast with the model of this diagnosis", f"model_from={HERE}")
    estimate = (
        "Estimate the string again with the causes found",
        f"+experiment=estimate estimate=least_squares model_from={HERE} {trials}",
    )
    if diagnosis.verdict == "effect":
        return [cast, estimate]
    if diagnosis.verdict == "ambiguous":
        return [decide, check]
    if diagnosis.verdict == "partial":
        return [check, cast]
    return [cast] if diagnosis.verdict == "none" else [check]


def page_provenance(experiment: Experiment) -> dict[str, Any]:
    """Return the provenance shown on a page."""
    graph = experiment.mode.graph(experiment.config)
    stages = {"stages": graph.describe_sources()}
    return {"seed": experiment.seed} | stages | software_versions()
