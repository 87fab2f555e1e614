"""What commands share: the world of a stored run, and a run's steps walked through without making any."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data import dataset
from stringcast.pipeline.experiment import MEASURED, STUDIES, Experiment, prepare
from stringcast.pipeline.run import Iteration, Result, work
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.steps import Past


class NotMadeError(Exception):
    """A step that others need is not there; what comes after it is not there either."""


@dataclass(frozen=True)
class Reader:
    """The desk at which nothing is made: every step is handed to `ask`, which returns its stored artifact."""

    ask: Callable[[str, Past], Any]

    def step(self, name: str, past: Past) -> Any:
        """A stored artifact."""
        return self.ask(name, past)

    def publish(self, iterations: list[Iteration]) -> None:
        """Nothing is written."""


def walk(here: Experiment, folder: Path, ask: Callable[[str, Past], Any]) -> Result | None:
    """Ask for every step of a run in its order; None where `ask` raises NotMadeError before the end."""
    if here.config["steps"] in (*STUDIES, MEASURED):
        raise UserError(
            f"{folder}: a study has no steps of its own. Name that of a cast, an estimation or a diagnosis."
        )
    try:
        return work(here, folder, Reader(ask))
    except NotMadeError:
        return None


def stored_experiment(folder: Path) -> Experiment:
    """What a run works with, from its config.json. Raises UserError where there is none, or one of another version."""
    path = folder / "config.json"
    if not path.is_file():
        raise UserError(f"{folder}: there is no run here (it has no config.json). Name a run's folder.")
    try:
        return prepare(dataset.settings(path), lambda block: str(path))
    except KeyError as error:
        raise UserError(f"{path}: it lacks the setting {error}: another version of this code made the run.") from error


def run_of(place: Path) -> Path:
    """The run's folder that a path lies in. Raises UserError where there is none."""
    if not place.exists():
        raise UserError(f"{place}: there is no such file or folder. Name one of a run.")
    whole = place.resolve()
    found = next((folder for folder in (whole, *whole.parents) if (folder / "config.json").is_file()), None)
    if found is None:
        raise UserError(f"{place}: it lies in no run (no config.json above it). Name a file or folder of a run.")
    return found
