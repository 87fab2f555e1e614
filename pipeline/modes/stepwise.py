"""Runs of stored steps, which can be continued, verified and compared."""

from __future__ import annotations

import logging
from abc import abstractmethod
from importlib import import_module
from pathlib import Path

from rich.markup import escape

from stringcast.data.errors import ExpectedError
from stringcast.data.lazy_module import MissingPackageError
from stringcast.pipeline.cli.console import print_summary, progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.experiment import Experiment, Mode
from stringcast.pipeline.run.file_names import LOG_FILE, SUMMARY_FILE
from stringcast.pipeline.run.iterations import Executor
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.execute.interfaces import HardwareError

log = logging.getLogger(__name__)


class Stepwise(Mode):
    """A mode of steps that an executor makes or reads."""

    @abstractmethod
    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        """Run all steps in order, in the folder of the run."""

    def perform(
        self, experiment: Experiment, folder: Path, console: Terminal
    ) -> RunResult:
        """Run the steps, write the report, and last run.json, which marks completion.

        If a step was interrupted, raises KeyboardInterrupt instead of writing run.json.
        """
        saved_outputs = experiment.config["saved_outputs"]
        if self.moves_arm(experiment.config) and not (folder / SUMMARY_FILE).exists():
            check_devices(experiment)
        with progress_bars(console) as bar:
            graph = self.graph(experiment.config)
            steps = run_folder.RunFolder(
                experiment, folder, graph, bar, lambda text: console.print(escape(text))
            )
            result = self.run_steps(experiment, folder, steps)
            run_folder.write_stage_files(result)
            if "report" in saved_outputs:
                with bar("report"):
                    write_page(experiment, result, console)
            if not steps.interrupted:
                run_folder.write_summary(result)
        if "frames" not in saved_outputs and not steps.interrupted:
            run_folder.remove_frames(experiment, result)
        print_summary(result, console)
        if steps.interrupted:
            raise KeyboardInterrupt
        return result


def write_page(experiment: Experiment, result: RunResult, console: Terminal) -> None:
    """Write the run's page; the run survives a failure.

    An existing page is kept if its frames were not.
    """
    page = result.folder / "report.html"
    if page.exists() and run_folder.lacks_frames(result):
        console.print_line("report.html stays as it is: the frames were not kept.")
        return
    # imported here because it takes a second
    report = import_module("stringcast.pipeline.run.report")
    try:
        report.write_report(experiment, result)
    except ExpectedError:  # such as a full disk
        raise
    except Exception as error:
        log.exception("report.html was not drawn")
        console.print_line(
            f"report.html was not drawn ({error!r}). All results are stored. Please "
            f"report this, with {result.folder / LOG_FILE}."
        )


def check_devices(experiment: Experiment) -> None:
    """Open arm and camera before planning, or raise HardwareError with all faults."""
    lab = experiment.lab(1)
    faults = []
    for device in (lab.arm, lab.camera):
        try:
            with device:
                pass
        except (HardwareError, MissingPackageError) as error:
            faults.append(str(error))
    if faults:
        raise HardwareError("", "\n".join(faults))


def require_trials(experiment: Experiment) -> None:
    """Raise UserError without the setting `trials`."""
    if experiment.config["trials"] is None:
        raise UserError(
            "trials = null",
            "this mode looks at stored trials",
            "Give trials=<folder>, or another mode.",
        )


def refuse_trials(experiment: Experiment) -> None:
    """Raise UserError if the setting `trials` is given."""
    trials = experiment.config["trials"]
    if trials is not None:
        raise UserError(
            f"trials={trials}",
            "this mode makes its own trials",
            "Leave it out, or give +experiment=estimate, diagnose, decide or "
            "align, which look at stored ones.",
        )
