"""Compute every step of a run again from what is on the disk, and compare to the bit."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stringcast.data import store
from stringcast.data.errors import printable
from stringcast.pipeline import run_folder
from stringcast.pipeline.commands.stored import NotMadeError, stored_experiment, walk
from stringcast.pipeline.compare import differences, differing_files
from stringcast.pipeline.console import bars
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.iterations import Step
from stringcast.pipeline.layout import ENDED
from stringcast.pipeline.result import Result, in_numbers
from stringcast.pipeline.staleness import look, repeatable
from stringcast.pipeline.terminal import Terminal


def main(arguments: list[str]) -> int:
    """0 if the run is whole and every step comes out the same, 1 if not."""
    parser = argparse.ArgumentParser("python -m pipeline verify", description=__doc__)
    parser.add_argument("run", type=Path, help="the run's folder; nothing is written into it")
    folder = parser.parse_args(arguments).run
    here = stored_experiment(folder)
    with bars(Terminal(stderr=True)) as bar, TemporaryDirectory() as aside:
        outcome = verify(here, folder, Path(aside), bar)
    for line in outcome.lines:
        print(printable(line))
    return 0 if outcome.same else 1


@dataclass
class Outcome:
    """same: no step is missing, and none came out otherwise. lines: step by step, in words."""

    same: bool = True
    lines: list[str] = field(default_factory=list)

    def note(self, what: str, faults: list[str], good: str = "the same to the bit") -> None:
        """What came out of one comparison."""
        self.same = self.same and not faults
        self.lines += [f"{what}: {'DIFFERS' if faults else good}", *(f"    {fault}" for fault in faults)]


def verify(here: Experiment, folder: Path, aside: Path, bar: Callable[[str], AbstractContextManager[Any]]) -> Outcome:
    """Every step, then what the run wrote from them. aside: an empty folder to compute in."""
    outcome = Outcome()

    def ask(step: Step) -> Any:
        found = look(here.config, folder, step)
        if found.artifact is None:
            outcome.note(step.place.as_posix(), list(found.reasons))
            raise NotMadeError
        if not repeatable(here.config, step.stage.folder):
            outcome.note(step.place.as_posix(), [], "measured with a real arm and camera, cannot be computed again")
            return found.artifact
        with bar(f"{step.number}. {step.stage.name}") as progress:
            store.save(here.run(step, progress), aside / step.place, {})
        faults = _lines(differing_files(folder / step.place, aside / step.place))
        since = [f"since it was made: {reason}" for reason in found.reasons] if faults else []
        outcome.note(step.place.as_posix(), [*faults, *since])
        return found.artifact

    result = walk(here, folder, ask)
    if result is not None:
        _ending(here, folder, aside, result, outcome)
    return outcome


def _ending(here: Experiment, folder: Path, aside: Path, result: Result, outcome: Outcome) -> None:
    """The dataset and run.json: drawn from the steps alone, they must say what these say."""
    iterations = [i for i in result.iterations if {"trial", "points"} <= i.done.keys()]
    if here.config["trials"] is None and iterations:
        run_folder.publish(here, run_folder.trial_hashes(folder, iterations), aside, iterations)
        written = [*sorted(aside.glob("*.parquet")), aside / "dataset.yaml"]
        faults = {path.name: differences(folder / path.name, path) for path in written}
        outcome.note("the run as a dataset", _lines(faults))
    path = folder / ENDED
    if not path.is_file():
        outcome.note(ENDED, ["it is missing: the run has not ended; `resume` ends it"])
        return
    same = json.loads(path.read_text(encoding="utf-8")) == json.loads(json.dumps(in_numbers(result)))
    outcome.note(ENDED, [] if same else ["it says something else than the steps"])


def _lines(faults: Mapping[str, list[str]]) -> list[str]:
    return [f"{name}: {words}" for name, all_words in faults.items() for words in all_words]
