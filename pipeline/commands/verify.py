"""Compute every step of a run again from what is stored, and compare to the bit."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stringcast.data import store
from stringcast.data.compare import file_differences, folder_differences
from stringcast.data.errors import escape_control_characters
from stringcast.data.file_checks import read_json
from stringcast.data.schema import DataError
from stringcast.pipeline.cli.console import ProgressBar, progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import COST_OPTION, CommandParser, add_cost_option
from stringcast.pipeline.commands.stored_runs import (
    NotMadeError,
    read_stored_experiment,
    walk_steps,
)
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.cost import ask_about_cost
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.file_names import SUMMARY_FILE
from stringcast.pipeline.run.iterations import Step
from stringcast.pipeline.run.provenance import arm_is_virtual, load_step_with_staleness
from stringcast.pipeline.run.result import RunResult, run_summary

UNREPEATABLE_NOTE = "measured with a real arm and camera, cannot be computed again"


def main(arguments: list[str]) -> int:
    """Print the outcome for each step; return 0 if all are equal."""
    parser = CommandParser("python -m pipeline verify", description=__doc__)
    parser.add_argument(
        "run", type=Path, help="the run's folder; nothing is written into it"
    )
    add_cost_option(parser)
    options = parser.parse_args(arguments)
    folder: Path = options.run
    experiment = read_stored_experiment(folder)
    console = Terminal(stderr=True)
    ask_about_cost(experiment, options.max_core_hours, console, COST_OPTION)
    with progress_bars(console) as bar, TemporaryDirectory() as scratch:
        comparison = verify_run(experiment, folder, Path(scratch), bar)
    for line in comparison.lines:
        print(escape_control_characters(line))
    return 0 if comparison.is_same else 1


@dataclass
class Comparison:
    """Outcome of a verification.

    Attributes
    ----------
    is_same
        Whether every step exists and is equal.
    lines
        The outcome of each step.
    """

    is_same: bool = True
    lines: list[str] = field(default_factory=list)

    def note(self, name: str, faults: Sequence[str]) -> None:
        """Note the outcome of one comparison."""
        self.lines.append(f"{name}: {'DIFFERS' if faults else 'the same to the bit'}")
        for fault in faults:
            self.lines.append(f"    {fault}")
            self.is_same = False


def verify_run(
    experiment: Experiment, folder: Path, scratch: Path, bar: ProgressBar
) -> Comparison:
    """Compute every step of a run again, and the files written from them.

    Parameters
    ----------
    experiment : Experiment
        The run's experiment.
    folder : Path
        Folder of the run.
    scratch : Path
        An empty folder to compute in.
    bar : callable
        Makes the progress bar of a step by its name.
    """
    comparison = Comparison()

    def compare_step(step: Step) -> Any:
        stored = load_step_with_staleness(experiment.config, folder, step)
        name = step.folder.as_posix()
        if stored.artifact is None:
            comparison.note(name, stored.stale_reasons)
            raise NotMadeError
        if step.stage.moves_arm and not arm_is_virtual(experiment.config):
            comparison.lines.append(f"{name}: {UNREPEATABLE_NOTE}")
            return stored.artifact
        with bar(f"{step.number}. {step.stage.name}") as progress:
            artifact = experiment.run_step(step, progress)
            store.save(artifact, scratch / step.folder, {})
        step_folder = folder / step.folder
        not_kept = store.images_not_kept(step_folder)
        faults = folder_differences(step_folder, scratch / step.folder, not_kept)
        if faults:
            for reason in stored.stale_reasons:
                faults.append(f"since it was made: {reason}")
        comparison.note(name, faults)
        if not_kept:
            comparison.lines.append(
                "    its frames were not kept: digests are compared"
            )
            return replace(stored.artifact, images=artifact.images)
        return stored.artifact

    result = walk_steps(experiment, folder, compare_step)
    if result is not None:
        compare_dataset(experiment, folder, scratch, result, comparison)
        compare_summary(folder, result, comparison)
    return comparison


def compare_dataset(
    experiment: Experiment,
    folder: Path,
    scratch: Path,
    result: RunResult,
    comparison: Comparison,
) -> None:
    """Compare the dataset of a run with the one made from its steps."""
    measured = []
    for iteration in result.iterations:
        if iteration.measurement_names:
            measured.append(iteration)
    if experiment.config["trials"] is not None or not measured:
        return
    hashes = run_folder.trial_hashes(folder, measured)
    run_folder.publish_dataset(experiment, hashes, scratch, measured)
    faults = []
    for path in (*sorted(scratch.glob("*.parquet")), scratch / "dataset.yaml"):
        for difference in file_differences(folder / path.name, path):
            faults.append(f"{path.name}: {difference}")
    comparison.note("the run as a dataset", faults)


def compare_summary(folder: Path, result: RunResult, comparison: Comparison) -> None:
    """Compare run.json with the summary of the steps."""
    path = folder / SUMMARY_FILE
    faults = []
    if not path.is_file():
        faults.append("it is missing: the run has not ended; `resume` continues it")
    else:
        try:
            stored = read_json(path)
        except DataError as error:
            comparison.note(SUMMARY_FILE, [str(error)])
            return
        if stored != json.loads(json.dumps(run_summary(result))):
            faults.append("it differs from the summary of the steps")
    comparison.note(SUMMARY_FILE, faults)
