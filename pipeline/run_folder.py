"""A run's folder: steps are made once and kept, each whole before the next begins.

A step that is there and fresh is read, not made again: an interrupted run goes on where it stopped, with the same
result, for every step's seed is its own. One that is stale or damaged is made again, unless a real arm has moved by
it, and so is one that was interrupted and ended with what it knew, which no other follows. `run.json` is there if, and
only if, the run has ended.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from stringcast.data import dataset, disk, store
from stringcast.data.artifacts import Points, Trial
from stringcast.data.errors import remedy_for
from stringcast.data.foreign import json_block
from stringcast.data.images import Fresh
from stringcast.data.schema import DataError
from stringcast.pipeline.console import Bar
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.inherited import FROM_DATASETS
from stringcast.pipeline.iterations import Iteration, Step
from stringcast.pipeline.layout import ENDED, FAILED, LOCK, LOG, place_of
from stringcast.pipeline.provenance import look, made_now, origin, performed, repeatable
from stringcast.pipeline.result import Result, in_numbers
from stringcast.pipeline.stopping import stoppable

log = logging.getLogger(__name__)

NOTHING = {"config.json", LOCK, FAILED, LOG}  # what a run that made nothing leaves


@dataclass
class RunFolder:
    """Makes the steps of a run and keeps them in its folder. say: tells the user of a step that is made again.
    interrupted: whether one ended with what it knew, which is kept until it is made again."""

    experiment: Experiment
    folder: Path
    bar: Bar
    say: Callable[[str], object]
    interrupted: bool = False

    def obtain(self, step: Step) -> Any:
        """Read a step's artifact if it is there and fresh, else make and store it. Raises DataError for a damaged one
        that cannot be made again, KeyboardInterrupt after one that was interrupted."""
        if self.interrupted:
            raise KeyboardInterrupt
        config, place = self.experiment.config, self.folder / step.place
        found = look(config, self.folder, step)
        if found.artifact is not None and not found.reasons:
            log.info("%s is there, and fresh", step.place)
            return found.artifact
        if not place.resolve().is_relative_to(self.folder.resolve()):
            raise DataError(f"{place}: it leads out of the run's folder by a link. Put the folder itself there.")
        if place.is_dir():
            # stale: it is used all the same where a real arm has moved by it
            stays = performed(config, self.folder, step.number, step.stage.folder)
            if stays and found.artifact is None:
                raise DataError(f"{found.reasons[0]} The arm has moved by it: it cannot be made again.")
            why = f"keeping {step.place}, by which the arm has moved" if stays else f"recomputing {step.place}"
            message = f"{why}: {'; '.join(found.reasons)}"
            log.warning(message)
            self.say(message)
            if stays:
                return found.artifact
        return self._made(step, place)

    def _made(self, step: Step, place: Path) -> Any:
        """A step's artifact, made now and stored."""
        disk.remove(self.folder / ENDED)
        with self.bar(f"{step.number}. {step.stage.name}") as progress:
            at, begun = datetime.now(UTC), time.monotonic()
            with stoppable():
                made = self.experiment.run(step, progress)
            self.interrupted = getattr(made, "interrupted", False)
            took = {"made": {"at": at.isoformat(timespec="seconds"), "seconds": time.monotonic() - begun}}
            store.save(made, place, made_now(self.experiment.config, self.folder, step) | took)
            log.info("%s made in %.1f s", step.place, took["made"]["seconds"])
        stored: Any = store.load(step.stage.makes, place)
        return replace(stored, images=Fresh(stored.images, made.images)) if isinstance(made, Trial) else stored

    def publish(self, iterations: list[Iteration]) -> None:
        """Keep the run a dataset that others can read. One that holds these trials already stays: no reader of a
        finished run is to see fewer of them."""
        made_of = trial_hashes(self.folder, iterations)
        try:
            files = [self.folder / f"{table.name}.parquet" for table in dataset.PUBLISHED]
            holds = all(made_of.items() <= store.origin_of(file)["inputs"].items() for file in files)
        except (*store.UNREADABLE, KeyError):
            holds = False
        if not (holds and (self.folder / "dataset.yaml").exists()):
            publish(self.experiment, made_of, self.folder, iterations)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Nobody else works in a run's folder meanwhile; raises DataError where somebody does, or it cannot be written.

    A folder in which a run that failed made nothing is removed again, unless something lay in it before.
    """
    with ExitStack() as held:
        try:
            disk.make_folder(folder)
            held.enter_context(disk.locked(folder / LOCK))
        except BlockingIOError as error:
            raise DataError(
                f"{folder}: another process is working in this folder. Wait for it, or choose another folder."
            ) from error
        except OSError as error:
            raise DataError(f"{folder}: cannot be written ({error.strerror}). {remedy_for(error)}.") from error
        new = _names(folder) <= {LOCK}
        try:
            yield
        except Exception:
            if new and _names(folder) <= NOTHING:
                disk.remove(folder)
            raise


def _names(folder: Path) -> set[str]:
    """Names of what lies in a folder."""
    return {file.name for file in folder.iterdir()}


def begin(experiment: Experiment, folder: Path) -> None:
    """Note the settings in the run's folder, or see that it is this one; a study may be asked for more than before."""
    path = folder / "config.json"
    text = json.dumps(experiment.config, indent=2, sort_keys=True)
    before = path.read_text(encoding="utf-8") if path.exists() else None
    if before not in (None, text):
        growing = experiment.mode.growing
        if _less(json_block(path), growing) != _less(json.loads(text), growing):
            raise DataError(
                f"{folder}: this folder holds a run with other settings (see config.json). "
                "Leave hydra.run.dir to its default, or repeat the settings of that run."
            )
    if before != text:
        store.write_text(path, text)
    disk.remove(folder / FAILED)


def _less(config: Mapping[str, Any], growing: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Settings less those of `Mode.growing`."""
    less = dict(config)
    for block, names in growing.items():
        if isinstance(less.get(block), Mapping):
            less[block] = {name: value for name, value in less[block].items() if name not in names}
    return less


def leave(result: Result) -> None:
    """Write what the stage leaves that the run was for."""
    if result.stage is not None:
        ahead = place_of(result.iterations[-1].number + 1)
        for name, text in result.stage.files(result.answer, ahead).items():
            store.write_text(result.folder / name, text)


def end(result: Result) -> None:
    """Write run.json: the run in a few numbers."""
    store.write_text(result.folder / ENDED, json.dumps(in_numbers(result), indent=2))


def without_frames(experiment: Experiment, result: Result) -> None:
    """Remove the frames of a run that has ended; all that was read in them stays. A real camera's are kept: nobody can
    film them again."""
    if not repeatable(experiment.config, "trial"):
        return
    for made in (result.folder / place_of(i.number, "trial") for i in result.iterations if "trial" in i.done):
        for inside in (path for path in made.iterdir() if path.is_dir()):
            disk.remove(inside)


@contextmanager
def failing(folder: Path) -> Iterator[None]:
    """Note in the folder why a run stopped, as far as that can be written."""
    try:
        yield
    except Exception as error:
        with suppress(DataError):
            store.write_text(folder / FAILED, f"{error}\n")
        raise


def forget(folder: Path) -> None:
    """Remove the folder of a run that was refused before it began. One with anything in it, which may be another
    run's, stays."""
    with suppress(OSError):
        folder.rmdir()


def publish(experiment: Experiment, made_of: Mapping[str, str], to: Path, iterations: list[Iteration]) -> None:
    """Write the trials of a run as a dataset to a folder. made_of: `trial_hashes`."""
    trials: dict[str, tuple[Trial, Points]] = {i.name: (i.done["trial"], i.done["points"]) for i in iterations}
    camera = {k: experiment.config["camera"][k] for k in FROM_DATASETS["camera"] if k in experiment.config["camera"]}
    about = {
        "name": experiment.config["name"],
        "string": {"length": experiment.string.length},
        "arm": {"links": list(experiment.arm.links), "base": list(experiment.arm.base)},
        "camera": camera,
    }
    refused = {i.name: {"invalid": i.refused} for i in iterations if i.refused}
    about |= {"trials": refused} if refused else {}
    places = {i.name: place_of(i.number, "trial") for i in iterations}
    dataset.publish(to, trials, places, about, origin(experiment.config, "dataset", experiment.seed, made_of))


def trial_hashes(folder: Path, iterations: list[Iteration]) -> dict[str, str]:
    """Content hashes of what a dataset is made of, by path."""
    made_of = [place_of(i.number, artifact) for i in iterations for artifact in ("trial", "points")]
    return {place.as_posix(): store.content_hash(folder / place) for place in made_of}
