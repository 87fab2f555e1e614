"""Read stored trials, of a run or of a dataset, for a new run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from stringcast.data import dataset
from stringcast.data.artifacts import Observation
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Executor, History
from stringcast.stages.check.check import refuse_errors
from stringcast.stages.check.measured import CheckedDataset


def read_usable_trials(experiment: Experiment) -> dataset.Dataset:
    """Read the stored trials that fit the string, or raise DataError without any."""
    trials, length = experiment.config["trials"], experiment.string.length
    stored = dataset.read_dataset(Path(trials))
    refuse_errors(CheckedDataset(stored, experiment.arm, experiment.camera, length))
    data = dataset.exclude_stray_points(stored, length)
    data.require_trial(f"trials={trials}")
    return data


def held_out_trials(data: dataset.Dataset) -> tuple[str, ...]:
    """Return the names of the trials that dataset.yaml holds out."""
    blocks = data.metadata.get("trials", {})
    return tuple(
        name for name, block in blocks.items() if block.get("role") == "held_out"
    )


def history_of_dataset(data: dataset.Dataset, executor: Executor) -> History:
    """Return the history of a run of stored trials, with the hashes of their files."""
    hashes = {
        (data.folder / name).as_posix(): digest for name, digest in data.hashes.items()
    }
    return History(executor, file_hashes=hashes)


def read_points(
    history: History, data: dataset.Dataset, name: str, again: bool
) -> Observation:
    """Return a trial with its points, in an iteration of its own.

    Points are extracted from frames if none are stored, or if `again` is true.
    """
    stored, film = data.trials[name], data.films.get(name)
    if film is None or not (stored.points.empty or again):
        history.begin_iteration()
        return stored
    history.begin_iteration(given={"trial": film})
    points = history.make_artifact("extract")
    return replace(
        stored, points=points.points, readings=points.readings, masks=points.masks
    )
