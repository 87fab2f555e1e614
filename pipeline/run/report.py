"""Collect what a run has made and write its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.utils import get_object

from stringcast.data.artifacts import Diagnosis
from stringcast.data.store import write_text
from stringcast.pipeline.cli.terminal import program_name
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.provenance import software_versions
from stringcast.pipeline.run.result import RunResult
from stringcast.stages.report.page import FOLDER_PLACEHOLDER as HERE
from stringcast.stages.report.pages.cast import cast_page
from stringcast.stages.report.records import RunRecord, StageRecord, simulate_cast
from stringcast.stages.spec import StageSpec


def write_report(experiment: Experiment, result: RunResult) -> None:
    """`report.html` in the run's folder: the page of the stage that the run was for, or
    that of its casts.
    """
    if result.stage is not None:
        write_stage_page(
            experiment,
            result.stage,
            result.final_artifact,
            result.sentence,
            result.folder,
        )
    else:
        write_text(
            result.folder / "report.html", cast_page(collect_casts(experiment, result))
        )


def write_stage_page(
    experiment: Experiment, stage: StageSpec, made: Any, sentence: str, folder: Path
) -> None:
    """The page of a stage. made: its artifact."""
    name, config = experiment.config["name"], experiment.config
    ahead = COMMANDS_AFTER_STAGE.get(stage.name, lambda made, config: [])(made, config)
    facts = StageRecord(
        name,
        sentence,
        made,
        experiment.model,
        config,
        page_provenance(experiment),
        next_commands(ahead),
    )
    write_text(folder / "report.html", get_object(f"stringcast.{stage.page}")(facts))


def collect_casts(experiment: Experiment, result: RunResult) -> RunRecord:
    """The data of the page of casts."""
    estimates = [i.artifacts.get("estimate") for i in result.iterations]
    casts, previous = [], None
    for iteration in result.iterations:
        if iteration.verdict is not None:  # else only estimation ran
            done = iteration.artifacts
            made = (done["motion"], done["trial"], done["points"], done.get("estimate"))
            casts.append(
                simulate_cast(
                    experiment.model,
                    iteration.observation,
                    made,
                    iteration.verdict,
                    previous,
                )
            )
            previous = done.get("estimate", previous)
    return RunRecord(
        experiment.config["name"],
        result.sentence,
        result.has_hit,
        experiment.model,
        experiment.target,
        experiment.obstacles,
        tuple(casts),
        tuple(e for e in estimates if e is not None),
        experiment.config,
        page_provenance(experiment),
        next_commands(commands_after_casts(result)),
    )


def next_commands(ahead: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """The commands that a page offers, as this program is called. ahead: why, and the
    arguments.
    """
    always = ("Compute every step again and compare, to the bit", f"verify {HERE}")
    return [(why, f"{program_name()} {words}") for why, words in (*ahead, always)]


def commands_after_casts(result: RunResult) -> list[tuple[str, str]]:
    """The commands to offer after casts, or after estimation alone."""
    wrong = (
        "What does the simulation get wrong in these trials, and why?",
        f"+experiment=diagnose trials={HERE}",
    )
    ahead = [wrong] if not all(i.refusal_reason for i in result.iterations) else []
    if (
        result.last_estimate is not None
        and result.last_estimate.parameters["low"].isna().all()
    ):
        words = f"+experiment=estimate estimate=least_squares trials={HERE}"
        ahead.append(
            ("Estimate the string from the same trials, with intervals", words)
        )
    if result.last_estimate is not None:
        ahead.append(
            (
                "A card of the string's parameters, with units",
                f"export {HERE} string.csv",
            )
        )
    return ahead


def commands_after_diagnosis(
    made: Diagnosis, config: Mapping[str, Any]
) -> list[tuple[str, str]]:
    """The commands to offer after a diagnosis, by its verdict."""
    look = (
        "Look at the measurements: what is usable, what looks wrong",
        f"check {config['trials']}",
    )
    decide = (
        "Perform the motion that tells the look-alikes apart",
        f"+experiment=decide trials={config['trials']}",
    )
    cast = ("Cast with the model that this diagnosis made", f"model_from={HERE}")
    words = f"+experiment=estimate estimate=least_squares model_from={HERE} trials={config['trials']}"
    fit = ("Estimate the string anew with the causes at work", words)
    by_verdict = {"effect": [cast, fit], "ambiguous": [decide, look], "none": [cast]}
    return by_verdict.get(made.verdict, [look])


# what can be done after a stage, by its name
COMMANDS_AFTER_STAGE = {"diagnose": commands_after_diagnosis}


def page_provenance(experiment: Experiment) -> dict[str, Any]:
    """The provenance that a page shows."""
    return {"seed": experiment.seed} | software_versions()
