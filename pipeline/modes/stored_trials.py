"""Read stored trials of a run or dataset for a new run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from stringcast.data import dataset
from stringcast.data.artifacts import Film, Observation, Points
from stringcast.data.schema import DataError
from stringcast.pipeline.modes.stepwise import Stepwise
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Executor, History, with_points
from stringcast.pipeline.run.stage_graph import StageGraph
from stringcast.pipeline.settings.settings_from_runs import is_run_folder
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.check.check import refuse_errors
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.model.effects.time_offset import TimeOffset

# artifacts of a stored trial
STORED_FILM = "trial"
STORED_POINTS = "points"
STORED_ARTIFACTS = {STORED_FILM: Film, STORED_POINTS: Points}


def read_usable_trials(experiment: Experiment) -> dataset.Dataset:
    """Read the stored trials that fit the string, or raise DataError if none does."""
    trials = experiment.config["trials"]
    data = check_trials(experiment, dataset.read_dataset(Path(trials)))
    data.require_trial(f"trials={trials}")
    return data


def check_trials(experiment: Experiment, stored: dataset.Dataset) -> dataset.Dataset:
    """Drop points beyond the string; raise DataError if the data are clearly wrong."""
    length = experiment.string.length
    refuse_errors(CheckedDataset(stored, experiment.arm, experiment.camera, length))
    return dataset.exclude_stray_points(stored, length)


def refuse_unlike_clocks(
    experiment: Experiment, folder: Path, observations: Sequence[Observation]
) -> None:
    """Raise DataError for a dataset with clearly different clocks.

    Trials of a run have one clock, and known clocks are in the model.
    """
    if is_run_folder(folder) or TimeOffset in experiment.model.effects:
        return
    # takes seconds to import
    offset = import_module("stringcast.stages.clock.offset")
    rng = np.random.default_rng(experiment.seed)
    try:
        offset.refuse_wrong_clock(experiment.model, observations, rng)
    except DataError as error:
        place = f"{folder}: {error.place}"
        raise DataError(place, error.fault, error.remedy) from error


def history_of_dataset(
    data: dataset.Dataset, executor: Executor, graph: StageGraph
) -> History:
    """Return the history of a run on stored trials, with the hashes of their files."""
    hashes = {
        (data.folder / name).as_posix(): digest for name, digest in data.hashes.items()
    }
    return History(executor, file_hashes=hashes, graph=graph)


@dataclass(frozen=True)
class StoredTrialsMode(Stepwise):
    """A mode that reads stored trials.

    Parameters
    ----------
    reading : tuple of str
        Stages applied to each stored trial. Those that take frames are left out without
        frames, or if points are stored.
    again : bool
        Extract points again even if points are stored.
    """

    reading: tuple[str, ...]
    again: bool

    def read_trial(
        self, history: History, data: dataset.Dataset, name: str, consumer: str
    ) -> Observation:
        """Return a trial with its points, as a new iteration of the history.

        `consumer` is the stage that takes the trial, with the points wired to it.
        Raises DataError for a stage that needs frames, without frames.
        """
        stored, film = data.trials[name], data.films.get(name)
        reads_frames = film is not None and (stored.points.empty or self.again)
        given: dict[str, Any] = {STORED_FILM: film}
        if not reads_frames:
            points = Points(stored.points, stored.readings, stored.masks)
            given = dict.fromkeys(names_of_read_points(self.reading), points)
        iteration = history.begin_iteration(given=given)
        for stage in self.reading:
            if reads_frames or not stages()[stage].takes_frames:
                if lacking := history.lacking_input(stage):
                    raise DataError(
                        data.folder,
                        f"stage {stage} takes {lacking}, which is made from "
                        f"frames, but of trial {name} the stored points are used",
                        "Leave the stage out of mode.reading, or read stored "
                        "frames: mode.again=true.",
                    )
                history.make_artifact(stage)
        if not iteration.artifacts:
            return stored
        return with_points(stored, history.wired_points(iteration, consumer))


def names_of_read_points(reading: Sequence[str]) -> list[str]:
    """Return the artifact names of points extracted from frames."""
    specs = [stages()[name] for name in reading]
    names = [
        spec.folder
        for spec in specs
        if spec.takes_frames and issubclass(spec.makes, Points)
    ]
    return names or [STORED_POINTS]
