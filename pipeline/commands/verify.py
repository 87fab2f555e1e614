"""Compute every step of a run again from what is stored, and compare to the bit."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stringcast.data import store
from stringcast.data.compare import file_differences, folder_differences
from stringcast.data.file_checks import read_json
from stringcast.data.metadata import DATASET_FILE
from stringcast.data.schema import DataError
from stringcast.pipeline.cli.console import ProgressBar, progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import COST_OPTION, CommandParser, add_cost_option
from stringcast.pipeline.commands.stored_runs import read_stored_experiment
from stringcast.pipeline.modes.stepwise import Stepwise
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.cost import ask_about_cost
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.file_names import SUMMARY_FILE
from stringcast.pipeline.run.iterations import Iteration, Step
from stringcast.pipeline.run.provenance import (
    lab_is_repeatable,
    load_step_with_staleness,
)
from stringcast.pipeline.run.result import RunResult, run_summary
from stringcast.pipeline.settings.composition import UserError

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
        verification = verify_run(experiment, folder, Path(scratch), bar)
    for line in verification.lines:
        Terminal().print_line(line)
    return 0 if verification.is_same else 1


class NotMadeError(Exception):
    """A missing step; later steps cannot be made again."""


@dataclass
class Verification:
    """An executor that makes each step again, and compares it with the stored one.

    folder: of the run. scratch: an empty folder to compute in. bar: makes the progress
    bar of a step by its name. is_same: whether every step exists and is equal. lines:
    the outcome of each comparison.
    """

    experiment: Experiment
    folder: Path
    scratch: Path
    bar: ProgressBar
    is_same: bool = True
    lines: list[str] = field(default_factory=list)

    def obtain(self, step: Step) -> Any:
        """Make a step again, and return the stored artifact for later steps.

        Raises NotMadeError for a missing step.
        """
        experiment, step_folder = self.experiment, self.folder / step.folder
        stored = load_step_with_staleness(experiment.config, self.folder, step)
        name = step.folder.as_posix()
        if stored.artifact is None:
            self.note(name, stored.stale_reasons)
            raise NotMadeError
        if step.stage.moves_arm and not lab_is_repeatable(experiment.config):
            self.lines.append(f"{name}: {UNREPEATABLE_NOTE}")
            return stored.artifact
        with self.bar(f"{step.number}. {step.stage.name}") as progress:
            artifact = experiment.run_step(step, progress)
            store.save(artifact, self.scratch / step.folder, {})
        not_kept = store.images_not_kept(step_folder)
        faults = folder_differences(step_folder, self.scratch / step.folder, not_kept)
        if faults:
            for reason in stored.stale_reasons:
                faults.append(f"since it was made: {reason}")
        self.note(name, faults)
        if not_kept:
            self.lines.append("    its frames were not kept: digests are compared")
            return replace(stored.artifact, images=artifact.images)
        return stored.artifact

    def publish(self, iterations: list[Iteration]) -> None:
        """Do nothing: the dataset is compared when all steps are."""

    def note(self, name: str, faults: Sequence[str]) -> None:
        """Note the outcome of one comparison."""
        self.lines.append(f"{name}: {'DIFFERS' if faults else 'the same to the bit'}")
        for fault in faults:
            self.lines.append(f"    {fault}")
            self.is_same = False


def verify_run(
    experiment: Experiment, folder: Path, scratch: Path, bar: ProgressBar
) -> Verification:
    """Compute every step of a run again, and the files written from them.

    The arguments are those of `Verification`.
    """
    if not isinstance(experiment.mode, Stepwise):
        raise UserError(
            folder,
            "this run, of a study or a calibration, has no steps of its own",
            "Name that of a cast, an estimation or a diagnosis.",
        )
    verification = Verification(experiment, folder, scratch, bar)
    with suppress(NotMadeError):
        result = experiment.mode.run_steps(experiment, folder, verification)
        compare_dataset(verification, result)
        compare_summary(verification, result)
    return verification


def compare_dataset(verification: Verification, result: RunResult) -> None:
    """Compare the dataset of a run with the one made from its steps."""
    experiment, folder = verification.experiment, verification.folder
    measured = [
        iteration for iteration in result.iterations if iteration.measurement_names
    ]
    if experiment.config["trials"] is not None or not measured:
        return
    scratch = verification.scratch
    hashes = run_folder.trial_hashes(folder, measured)
    run_folder.publish_dataset(experiment, hashes, scratch, measured)
    faults = []
    for path in (*sorted(scratch.glob("*.parquet")), scratch / DATASET_FILE):
        for difference in file_differences(folder / path.name, path):
            faults.append(f"{path.name}: {difference}")
    verification.note("the run as a dataset", faults)


def compare_summary(verification: Verification, result: RunResult) -> None:
    """Compare run.json with the summary of the steps."""
    path = verification.folder / SUMMARY_FILE
    faults = []
    if not path.is_file():
        faults.append("it is missing: the run has not ended; `resume` continues it")
    else:
        try:
            if read_json(path) != json.loads(json.dumps(run_summary(result))):
                faults.append("it differs from the summary of the steps")
        except DataError as error:
            faults.append(str(error))
    verification.note(SUMMARY_FILE, faults)
