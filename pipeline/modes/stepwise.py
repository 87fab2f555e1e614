"""A run that is made of steps, each kept in its folder: it can be gone on with, verified and asked what is stale."""

from __future__ import annotations

from abc import abstractmethod
from importlib import import_module
from pathlib import Path

from rich.markup import escape

from stringcast.pipeline import run_folder
from stringcast.pipeline.console import bars, show
from stringcast.pipeline.experiment import Experiment, Mode
from stringcast.pipeline.iterations import Executor
from stringcast.pipeline.layout import ENDED
from stringcast.pipeline.result import Result
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.execute.interfaces import HardwareError


class Stepwise(Mode):
    """A mode whose steps an executor makes or looks up."""

    @abstractmethod
    def work(self, experiment: Experiment, folder: Path, executor: Executor) -> Result:
        """All steps in their order. folder: the run's."""

    def perform(self, experiment: Experiment, folder: Path, console: Terminal) -> Result:
        """Make the steps, the report, and at last run.json, whose presence says that all is there. Raises
        KeyboardInterrupt instead of that where a step was interrupted, and ended with what it knew."""
        if self.moves(experiment.config) and not (folder / ENDED).exists():
            check_devices(experiment)
        with bars(console) as bar:
            kept = run_folder.RunFolder(experiment, folder, bar, lambda words: console.print(escape(words)))
            result = self.work(experiment, folder, kept)
            if "report" in experiment.config["keep"]:
                with bar("report"):  # which draws: it takes a second and more to load
                    import_module("stringcast.pipeline.report").write(experiment, result)
            run_folder.leave(result)
            if not kept.interrupted:
                run_folder.end(result)
        if "frames" not in experiment.config["keep"] and not kept.interrupted:
            run_folder.without_frames(experiment, result)
        show(result, console)
        if kept.interrupted:
            raise KeyboardInterrupt
        return result


def check_devices(experiment: Experiment) -> None:
    """Open arm and camera before anything is planned for them. Raises HardwareError with all that is wrong of both."""
    lab = experiment.lab(1)
    faults = []
    for device in (lab.arm, lab.camera):
        try:
            with device:
                pass
        except HardwareError as error:
            faults.append(str(error))
    if faults:
        raise HardwareError("\n".join(faults))


def needs_trials(experiment: Experiment) -> None:
    """Raise UserError where no stored trials are named."""
    if experiment.config["trials"] is None:
        raise UserError("trials = null: this mode looks at stored trials. Give trials=<folder>, or another mode.")


def needs_none(experiment: Experiment) -> None:
    """Raise UserError where stored trials are named."""
    if experiment.config["trials"] is not None:
        trials = experiment.config["trials"]
        raise UserError(
            f"trials={trials}: this mode makes its own trials. Leave it out, or give +experiment=estimate, diagnose, "
            "decide or align, which look at stored ones."
        )
