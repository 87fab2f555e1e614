"""A run's folder: steps are made once, and each is complete before the next begins.

A fresh step is read, not made again. Each step has its own seed, so an interrupted run
continues to the same result. A stale or damaged step is made again, unless a real arm
has executed it. A step that was interrupted with a preliminary result is also made
again. `run.json` exists if, and only if, the run has ended.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from stringcast.data import dataset, disk, store
from stringcast.data.artifacts import Trial
from stringcast.data.errors import remedy_for
from stringcast.data.file_checks import read_json
from stringcast.data.images import RecentImages
from stringcast.data.schema import DataError
from stringcast.data.table_files import RUN_TABLES
from stringcast.pipeline.cli.console import ProgressBar
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.file_names import (
    FAILURE_FILE,
    LOCK_FILE,
    LOG_FILE,
    SUMMARY_FILE,
    artifact_folder,
    kept_folder,
)
from stringcast.pipeline.run.iterations import Iteration, Step
from stringcast.pipeline.run.kept_files import KeptFiles
from stringcast.pipeline.run.provenance import (
    arm_has_executed,
    current_origin,
    lab_is_repeatable,
    load_step_with_staleness,
    software_versions,
    step_origin,
)
from stringcast.pipeline.run.result import RunResult, run_summary
from stringcast.pipeline.run.stage_graph import StageGraph
from stringcast.pipeline.run.stopping import stop_stage_on_interrupt
from stringcast.pipeline.settings.settings_from_runs import DATASET_SETTINGS
from stringcast.stages.kept_results import use_store

log = logging.getLogger(__name__)

FILES_OF_EMPTY_RUN = {"config.json", LOCK_FILE, FAILURE_FILE, LOG_FILE}


@dataclass
class RunFolder:
    """An executor that makes the steps of a run and stores them in its folder.

    Parameters
    ----------
    experiment : Experiment
        What the run works with.
    folder : Path
        Folder of the run.
    graph : StageGraph
        Graph of its stages.
    bar : callable
        Creates the progress bar of a step from its name.
    notify : callable
        Tells the user about a step that is made again.
    interrupted : bool
        A step was interrupted and stored a preliminary result.
    hashes : dict
        Content hashes of steps by their folders.
    """

    experiment: Experiment
    folder: Path
    graph: StageGraph
    bar: ProgressBar
    notify: Callable[[str], object]
    interrupted: bool = False
    hashes: dict[Path, str] = field(default_factory=dict, repr=False)

    def content_hash(self, folder: Path) -> str:
        """Return the content hash of a step's folder, read once."""
        if folder not in self.hashes:
            self.hashes[folder] = store.content_hash(folder)
        return self.hashes[folder]

    def obtain(self, step: Step) -> Any:
        """Return a step's artifact: the stored one if it is fresh, else a new one.

        Raises DataError for a damaged artifact that cannot be made again, and
        KeyboardInterrupt after a step that was interrupted.
        """
        if self.interrupted:
            raise KeyboardInterrupt
        config, folder = self.experiment.config, self.folder / step.folder
        stored = load_step_with_staleness(config, self.folder, step, self.content_hash)
        if stored.artifact is not None and not stored.stale_reasons:
            log.info("%s is stored and fresh", step.folder)
            return stored.artifact
        if not folder.is_dir():
            return self._make_artifact(step, folder)

        # a stale step is still used if a real arm has executed it
        reasons = "; ".join(stored.stale_reasons)
        number, stage = step.number, step.stage.name
        if not arm_has_executed(config, self.folder, number, stage, self.graph):
            self._warn(f"recomputing {step.folder}: {reasons}")
            return self._make_artifact(step, folder)
        if stored.artifact is None:
            remedy = "The arm has moved by it: it cannot be made again."
            raise DataError("", stored.stale_reasons[0], remedy)
        self._warn(f"keeping {step.folder}, by which the arm has moved: {reasons}")
        return stored.artifact

    def _warn(self, message: str) -> None:
        log.warning(message)
        self.notify(message)

    def _make_artifact(self, step: Step, folder: Path) -> Any:
        """Make a step's artifact and store it."""
        disk.remove(self.folder / SUMMARY_FILE)
        with self.bar(f"{step.number}. {step.stage.name}") as progress:
            started_at, start = datetime.now(UTC), time.monotonic()
            kept = KeptFiles(kept_folder(folder), software_versions())
            with use_store(kept), stop_stage_on_interrupt():
                artifact = self.experiment.run_step(step, progress)
            self.interrupted = getattr(artifact, "was_interrupted", False)
            seconds = time.monotonic() - start
            config = self.experiment.config
            origin = current_origin(config, self.folder, step, self.content_hash)
            origin["made"] = {
                "at": started_at.isoformat(timespec="seconds"),
                "seconds": seconds,
            }
            self.hashes.pop(folder, None)
            store.save(artifact, folder, origin)
            if not self.interrupted:
                kept.remove()
            log.info("%s made in %.1f s", step.folder, seconds)
        stored: Any = store.load(step.stage.makes, folder)
        if isinstance(artifact, Trial):  # its images are still in memory
            recent = RecentImages(stored.images, artifact.images)
            return replace(stored, images=recent)
        return stored

    def publish(self, iterations: list[Iteration]) -> None:
        """Write the run as a dataset.

        A dataset with at least these trials stays, so that no reader of a finished run
        sees fewer.
        """
        iterations = [it for it in iterations if it.measurement_names]
        if not iterations:
            return
        hashes = trial_hashes(self.folder, iterations, self.content_hash)
        try:
            holds_trials = True
            for table in RUN_TABLES:
                origin = store.read_origin(self.folder / f"{table.name}.parquet")
                holds_trials &= hashes.items() <= origin["inputs"].items()
        except (DataError, *store.READ_ERRORS, KeyError):
            holds_trials = False
        if not (holds_trials and (self.folder / "dataset.yaml").exists()):
            publish_dataset(self.experiment, hashes, self.folder, iterations)


@contextmanager
def exclusive_access(folder: Path) -> Iterator[None]:
    """Lock a run's folder, and make it if it does not exist.

    If a failed run made nothing, the folder is removed, unless it had content before.

    Raises DataError if the folder holds a link, is in use, or cannot be written.
    """
    refuse_links(folder)
    with ExitStack() as stack:
        try:
            disk.make_folder(folder)
            stack.enter_context(disk.hold_lock(folder / LOCK_FILE))
        except BlockingIOError as error:
            fault = "another process is working in this folder"
            remedy = "Wait for it, or choose another folder."
            raise DataError(folder, fault, remedy) from error
        except OSError as error:
            fault = f"cannot be written ({error.strerror})"
            raise DataError(folder, fault, f"{remedy_for(error)}.") from error
        is_new = file_names_in(folder) <= {LOCK_FILE}
        try:
            yield
        except Exception:
            if is_new and file_names_in(folder) <= FILES_OF_EMPTY_RUN:
                disk.remove(folder)
            raise


def refuse_links(folder: Path) -> None:
    """Refuse a run's folder that holds a link.

    Through a link, a foreign run could write and remove files anywhere.
    """
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(place, name)
            if path.is_symlink():
                raise DataError(
                    path,
                    "a run's folder holds no links",
                    "Put what it leads to in its place if you trust it, or remove it.",
                )


def file_names_in(folder: Path) -> set[str]:
    """Return the names of a folder's content."""
    return {file.name for file in folder.iterdir()}


def begin_run(experiment: Experiment, folder: Path) -> None:
    """Write the settings to the run's folder, or require equal ones in it."""
    path = folder / "config.json"
    text = json.dumps(experiment.config, indent=2, sort_keys=True)
    stored = path.read_text(encoding="utf-8") if path.exists() else None
    if stored not in (None, text) and read_json(path) != json.loads(text):
        raise DataError(
            folder,
            "this folder holds a run with other settings (see config.json)",
            "Leave out hydra.run.dir, or repeat the settings of that run.",
        )
    if stored != text:
        store.write_text(path, text)
    disk.remove(folder / FAILURE_FILE)


def write_stage_files(result: RunResult) -> None:
    """Write the files of the run's final stage."""
    if result.stage is None:
        return
    next_folder = artifact_folder(result.iterations[-1].number + 1)
    files = result.stage.files(result.final_artifact, next_folder)
    for name, text in files.items():
        store.write_text(result.folder / name, text)


def write_summary(result: RunResult) -> None:
    """Write the summary of a run to run.json."""
    text = json.dumps(run_summary(result), indent=2)
    store.write_text(result.folder / SUMMARY_FILE, text)


def remove_frames(experiment: Experiment, result: RunResult) -> None:
    """Remove the frames of a run that has ended.

    Frames of a real camera stay, as they cannot be filmed again.
    """
    if not lab_is_repeatable(experiment.config):
        return
    for iteration in result.iterations:
        for name, artifact in iteration.artifacts.items():
            if isinstance(artifact, Trial):
                folder = result.folder / artifact_folder(iteration.number, name)
                for path in image_folders(artifact, folder):
                    disk.remove(path)


def image_folders(trial: Trial, folder: Path) -> list[Path]:
    """Return the image folders of a trial."""
    names = {Path(file).parts[0] for file in trial.frames["file"]}
    return [path for path in folder.iterdir() if path.is_dir() and path.name in names]


def lacks_frames(result: RunResult) -> bool:
    """Return whether frames of a run were not kept."""
    for iteration in result.iterations:
        for name in iteration.artifacts:
            folder = result.folder / artifact_folder(iteration.number, name)
            if store.images_not_kept(folder):
                return True
    return False


@contextmanager
def record_failure(folder: Path) -> Iterator[None]:
    """Write into the folder why a run stopped, if possible."""
    try:
        yield
    except Exception as error:
        with suppress(DataError):
            store.write_text(folder / FAILURE_FILE, f"{error}\n")
        raise


def remove_empty_folder(folder: Path) -> None:
    """Remove the empty folder of a run that was refused before it began."""
    with suppress(OSError):
        folder.rmdir()


def publish_dataset(
    experiment: Experiment,
    hashes: Mapping[str, str],
    folder: Path,
    iterations: list[Iteration],
) -> None:
    """Write the trials of a run's iterations to a folder as a dataset.

    hashes: content hashes by path, of `trial_hashes`.
    """
    trials = {}
    trial_folders = {}
    invalid_trials = {}
    for iteration in iterations:
        name, artifacts = iteration.trial_name, iteration.artifacts
        trial, points = iteration.measurement_names
        trials[name] = artifacts[trial], artifacts[points]
        trial_folders[name] = artifact_folder(iteration.number, trial)
        if iteration.refusal_reason:
            invalid_trials[name] = {"invalid": iteration.refusal_reason}

    arm, camera = experiment.arm, experiment.config["camera"]
    known_settings = [name for name in DATASET_SETTINGS["camera"] if name in camera]
    metadata = {
        "name": experiment.config["name"],
        "string": {"length": experiment.string.length},
        "arm": {"links": list(arm.links), "base": list(arm.base)},
        "camera": {name: camera[name] for name in known_settings},
    }
    if invalid_trials:
        metadata["trials"] = invalid_trials
    origin = step_origin(experiment.config, "dataset", experiment.seed, hashes)
    dataset.write_dataset(folder, trials, trial_folders, metadata, origin)


def trial_hashes(
    folder: Path,
    iterations: list[Iteration],
    hash_of: Callable[[Path], str] = store.content_hash,
) -> dict[str, str]:
    """Return the content hashes of the trials and points of a run, by path."""
    hashes = {}
    for iteration in iterations:
        for artifact in iteration.measurement_names:
            path = artifact_folder(iteration.number, artifact)
            hashes[path.as_posix()] = hash_of(folder / path)
    return hashes
