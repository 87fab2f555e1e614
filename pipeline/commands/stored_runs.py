"""Stored runs, for commands: their experiment, and their steps walked through without
making any.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data.file_checks import read_json
from stringcast.pipeline.modes.stepwise import Stepwise
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.iterations import Iteration, Step
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import UserError


class NotMadeError(Exception):
    """A step that others need is not there; what comes after it is not there either."""


@dataclass(frozen=True)
class StepReader:
    """The executor that makes nothing: every step is handed to `ask`, which returns its
    stored artifact.
    """

    ask: Callable[[Step], Any]

    def obtain(self, step: Step) -> Any:
        """A stored artifact."""
        return self.ask(step)

    def publish(self, iterations: list[Iteration]) -> None:
        """Do nothing: a reader writes no dataset."""


def walk_steps(
    here: Experiment, folder: Path, ask: Callable[[Step], Any]
) -> RunResult | None:
    """Ask for every step of a run in its order; None where `ask` raises NotMadeError
    before the end.
    """
    if not isinstance(here.mode, Stepwise):
        raise UserError(
            f"{folder}: this run, of a study or a calibration, has no steps of its own. Name that of a cast, an "
            "estimation or a diagnosis."
        )
    try:
        return here.mode.run_steps(here, folder, StepReader(ask))
    except NotMadeError:
        return None


def read_stored_settings(folder: Path) -> dict[str, Any]:
    """A run's settings, from its config.json. Raises UserError where there is none."""
    path = folder / "config.json"
    if not path.is_file():
        raise UserError(
            f"{folder}: there is no run here (it has no config.json). Name a run's folder."
        )
    return read_json(path)


def read_stored_experiment(folder: Path) -> Experiment:
    """The experiment of a stored run, from its config.json. Raises UserError where
    there is none, or one of another version.
    """
    path = folder / "config.json"
    try:
        return prepare_experiment(read_stored_settings(folder), lambda block: str(path))
    except KeyError as error:
        raise UserError(
            f"{path}: it lacks the setting {error}: another version of this code made the run."
        ) from error


def run_folder_of(place: Path) -> Path:
    """The run's folder that a path lies in. Raises UserError where there is none."""
    if not place.exists():
        raise UserError(f"{place}: there is no such file or folder. Name one of a run.")
    whole = place.resolve()
    found = next(
        (
            folder
            for folder in (whole, *whole.parents)
            if (folder / "config.json").is_file()
        ),
        None,
    )
    if found is None:
        raise UserError(
            f"{place}: it lies in no run (no config.json above it). Name a file or folder of a run."
        )
    return found
