"""Stored runs: their settings, their experiment, and their folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stringcast.data.file_checks import read_json
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.settings.composition import UserError


def read_stored_settings(folder: Path) -> dict[str, Any]:
    """Return a run's settings; raise UserError if the folder holds no run."""
    path = folder / "config.json"
    if not path.is_file():
        raise UserError(
            folder,
            "there is no run here (it has no config.json)",
            "Name a run's folder.",
        )
    return read_json(path)


def read_stored_experiment(folder: Path) -> Experiment:
    """Return the experiment of a stored run.

    Raises UserError without a run, or for a run of an incompatible version.
    """
    path = folder / "config.json"
    try:
        return prepare_experiment(read_stored_settings(folder), lambda block: str(path))
    except KeyError as error:
        raise UserError(
            path,
            f"the setting {error} is missing",
            "Another version of this code made the run.",
        ) from error


def run_folder_of(path: Path) -> Path:
    """Return the run's folder that contains a path; raise UserError without one."""
    if not path.exists():
        raise UserError(
            path,
            "there is no such file or folder",
            "Name one of a run.",
        )
    folder = enclosing_run(path.resolve())
    if folder is None:
        raise UserError(
            path,
            "it lies in no run (no config.json above it)",
            "Name a file or folder of a run.",
        )
    return folder


def enclosing_run(path: Path) -> Path | None:
    """Return the innermost run's folder that is, or contains, an absolute path."""
    for folder in (path, *path.parents):
        if (folder / "config.json").is_file():
            return folder
    return None
