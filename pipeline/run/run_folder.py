"""A run's folder: steps are made once and kept, each whole before the next begins.

A step that is there and fresh is read, not made again: an interrupted run goes on where
it stopped, with the same result, for every step's seed is its own. One that is stale or
damaged is made again, unless a real arm has moved by it, and so is one that was
interrupted and ended with what it knew, which no other follows. `run.json` is there if,
and only if, the run has ended.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from stringcast.data import dataset, disk, store
from stringcast.data.artifacts import Points, Trial
from stringcast.data.errors import remedy_for
from stringcast.data.file_checks import read_json
from stringcast.data.images import RecentImages
from stringcast.data.schema import DataError
from stringcast.pipeline.cli.console import ProgressBar
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.file_names import (
    FAILURE_FILE,
    LOCK_FILE,
    LOG_FILE,
    SUMMARY_FILE,
    artifact_folder,
)
from stringcast.pipeline.run.iterations import Iteration, Step
from stringcast.pipeline.run.provenance import (
    arm_has_executed,
    current_origin,
    is_repeatable,
    load_step_with_staleness,
    step_origin,
)
from stringcast.pipeline.run.result import RunResult, run_summary
from stringcast.pipeline.run.stopping import stop_stage_on_interrupt
from stringcast.pipeline.settings.settings_from_runs import DATASET_SETTINGS

log = logging.getLogger(__name__)

# what a run that made nothing leaves
FILES_OF_EMPTY_RUN = {"config.json", LOCK_FILE, FAILURE_FILE, LOG_FILE}


@dataclass
class RunFolder:
    """Makes the steps of a run and keeps them in its folder. say: tells the user of a
    step that is made again. interrupted: whether one ended with what it knew, which is
    kept until it is made again.
    """

    experiment: Experiment
    folder: Path
    bar: ProgressBar
    notify: Callable[[str], object]
    interrupted: bool = False

    def obtain(self, step: Step) -> Any:
        """Read a step's artifact if it is there and fresh, else make and store it.
        Raises DataError for a damaged one that cannot be made again, KeyboardInterrupt
        after one that was interrupted.
        """
        if self.interrupted:
            raise KeyboardInterrupt
        config, place = self.experiment.config, self.folder / step.folder
        found = load_step_with_staleness(config, self.folder, step)
        if found.artifact is not None and not found.stale_reasons:
            log.info("%s is there, and fresh", step.folder)
            return found.artifact
        if not place.resolve().is_relative_to(self.folder.resolve()):
            raise DataError(
                f"{place}: it leads out of the run's folder by a link. Put the folder itself there."
            )
        if place.is_dir():
            # stale: it is used all the same where a real arm has moved by it
            stays = arm_has_executed(
                config, self.folder, step.number, step.stage.folder
            )
            if stays and found.artifact is None:
                raise DataError(
                    f"{found.stale_reasons[0]} The arm has moved by it: it cannot be made again."
                )
            why = (
                f"keeping {step.folder}, by which the arm has moved"
                if stays
                else f"recomputing {step.folder}"
            )
            message = f"{why}: {'; '.join(found.stale_reasons)}"
            log.warning(message)
            self.notify(message)
            if stays:
                return found.artifact
        return self._make_artifact(step, place)

    def _make_artifact(self, step: Step, place: Path) -> Any:
        """A step's artifact, made now and stored."""
        disk.remove(self.folder / SUMMARY_FILE)
        with self.bar(f"{step.number}. {step.stage.name}") as progress:
            at, begun = datetime.now(UTC), time.monotonic()
            with stop_stage_on_interrupt():
                made = self.experiment.run_step(step, progress)
            self.interrupted = getattr(made, "interrupted", False)
            took = {
                "made": {
                    "at": at.isoformat(timespec="seconds"),
                    "seconds": time.monotonic() - begun,
                }
            }
            store.save(
                made,
                place,
                current_origin(self.experiment.config, self.folder, step) | took,
            )
            log.info("%s made in %.1f s", step.folder, took["made"]["seconds"])
        stored: Any = store.load(step.stage.makes, place)
        return (
            replace(stored, images=RecentImages(stored.images, made.images))
            if isinstance(made, Trial)
            else stored
        )

    def publish(self, iterations: list[Iteration]) -> None:
        """Keep the run a dataset that others can read. One that holds these trials
        already stays: no reader of a finished run is to see fewer of them.
        """
        made_of = trial_hashes(self.folder, iterations)
        try:
            files = [
                self.folder / f"{table.name}.parquet" for table in dataset.RUN_TABLES
            ]
            holds = all(
                made_of.items() <= store.read_origin(file)["inputs"].items()
                for file in files
            )
        except (*store.READ_ERRORS, KeyError):
            holds = False
        if not (holds and (self.folder / "dataset.yaml").exists()):
            publish_dataset(self.experiment, made_of, self.folder, iterations)


@contextmanager
def exclusive_access(folder: Path) -> Iterator[None]:
    """Nobody else works in a run's folder meanwhile; raises DataError where somebody
    does, or it cannot be written.

    A folder in which a run that failed made nothing is removed again, unless something
    lay in it before.
    """
    with ExitStack() as held:
        try:
            disk.make_folder(folder)
            held.enter_context(disk.hold_lock(folder / LOCK_FILE))
        except BlockingIOError as error:
            raise DataError(
                f"{folder}: another process is working in this folder. Wait for it, or choose another folder."
            ) from error
        except OSError as error:
            raise DataError(
                f"{folder}: cannot be written ({error.strerror}). {remedy_for(error)}."
            ) from error
        new = file_names_in(folder) <= {LOCK_FILE}
        try:
            yield
        except Exception:
            if new and file_names_in(folder) <= FILES_OF_EMPTY_RUN:
                disk.remove(folder)
            raise


def file_names_in(folder: Path) -> set[str]:
    """Names of what lies in a folder."""
    return {file.name for file in folder.iterdir()}


def begin_run(experiment: Experiment, folder: Path) -> None:
    """Note the settings in the run's folder, or see that it is this one."""
    path = folder / "config.json"
    text = json.dumps(experiment.config, indent=2, sort_keys=True)
    before = path.read_text(encoding="utf-8") if path.exists() else None
    if before not in (None, text) and read_json(path) != json.loads(text):
        raise DataError(
            f"{folder}: this folder holds a run with other settings (see config.json). "
            "Leave hydra.run.dir to its default, or repeat the settings of that run."
        )
    if before != text:
        store.write_text(path, text)
    disk.remove(folder / FAILURE_FILE)


def write_stage_files(result: RunResult) -> None:
    """Write what the stage leaves that the run was for."""
    if result.stage is not None:
        ahead = artifact_folder(result.iterations[-1].number + 1)
        for name, text in result.stage.files(result.final_artifact, ahead).items():
            store.write_text(result.folder / name, text)


def write_summary(result: RunResult) -> None:
    """Write run.json: the run in a few numbers."""
    store.write_text(
        result.folder / SUMMARY_FILE, json.dumps(run_summary(result), indent=2)
    )


def remove_frames(experiment: Experiment, result: RunResult) -> None:
    """Remove the frames of a run that has ended; all that was read in them stays. A
    real camera's are kept: nobody can film them again.
    """
    if not is_repeatable(experiment.config, "trial"):
        return
    for made in (
        result.folder / artifact_folder(i.number, "trial")
        for i in result.iterations
        if "trial" in i.artifacts
    ):
        for inside in (path for path in made.iterdir() if path.is_dir()):
            disk.remove(inside)


@contextmanager
def record_failure(folder: Path) -> Iterator[None]:
    """Note in the folder why a run stopped, as far as that can be written."""
    try:
        yield
    except Exception as error:
        with suppress(DataError):
            store.write_text(folder / FAILURE_FILE, f"{error}\n")
        raise


def remove_empty_folder(folder: Path) -> None:
    """Remove the folder of a run that was refused before it began. One with anything in
    it, which may be another run's, stays.
    """
    with suppress(OSError):
        folder.rmdir()


def publish_dataset(
    experiment: Experiment,
    made_of: Mapping[str, str],
    to: Path,
    iterations: list[Iteration],
) -> None:
    """Write the trials of a run as a dataset to a folder. made_of: `trial_hashes`."""
    trials: dict[str, tuple[Trial, Points]] = {
        i.trial_name: (i.artifacts["trial"], i.artifacts["points"]) for i in iterations
    }
    camera = {
        k: experiment.config["camera"][k]
        for k in DATASET_SETTINGS["camera"]
        if k in experiment.config["camera"]
    }
    about = {
        "name": experiment.config["name"],
        "string": {"length": experiment.string.length},
        "arm": {"links": list(experiment.arm.links), "base": list(experiment.arm.base)},
        "camera": camera,
    }
    refused = {
        i.trial_name: {"invalid": i.refusal_reason}
        for i in iterations
        if i.refusal_reason
    }
    about |= {"trials": refused} if refused else {}
    places = {i.trial_name: artifact_folder(i.number, "trial") for i in iterations}
    dataset.write_dataset(
        to,
        trials,
        places,
        about,
        step_origin(experiment.config, "dataset", experiment.seed, made_of),
    )


def trial_hashes(folder: Path, iterations: list[Iteration]) -> dict[str, str]:
    """Content hashes of what a dataset is made of, by path."""
    made_of = [
        artifact_folder(i.number, artifact)
        for i in iterations
        for artifact in ("trial", "points")
    ]
    return {place.as_posix(): store.content_hash(folder / place) for place in made_of}
