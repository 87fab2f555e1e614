"""The iterations of a run, and the steps of which each is made."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from stringcast.data.artifacts import Observation, TrialSet
from stringcast.pipeline.layout import place_of
from stringcast.pipeline.registry import stages
from stringcast.stages.spec import StageSpec

if TYPE_CHECKING:
    from stringcast.stages.hit_test import Verdict  # which loads SciPy


@dataclass(frozen=True)
class Step:
    """A stage to be run in an iteration, from 1. inputs: artifacts, by name. places: where those lie that this run
    made, relative to its folder. hashes: of the content of files elsewhere, by path."""

    stage: StageSpec
    number: int
    inputs: Mapping[str, Any] = field(repr=False)
    places: tuple[Path, ...] = ()
    hashes: Mapping[str, str] = field(default_factory=dict, repr=False)

    @property
    def place(self) -> Path:
        """The folder of its artifact, relative to the run's."""
        return place_of(self.number, self.stage.folder)

    def seed(self, seed: int) -> int:
        """A seed of its own. seed: the run's."""
        text = f"{seed}/{self.number}/{self.stage.name}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


@dataclass(frozen=True)
class Iteration:
    """One manipulation. done: artifacts that its steps made, given: those that it began with, by name. verdict: whether
    the tip hit. trial: name of its trial, if it is not to be called by its number."""

    number: int
    done: dict[str, Any] = field(repr=False)
    verdict: Verdict | None = None
    trial: str = ""
    given: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """Name of its trial."""
        return self.trial or f"t{self.number:02d}"

    @property
    def refused(self) -> str:
        """The reason why nothing is learned from its trial; empty if it can be trusted."""
        link = self.done["trial"].link.iloc[0] if "trial" in self.done else {"valid": True}
        return "" if link["valid"] else str(link["reason"])

    @property
    def hit(self) -> bool:
        """Whether the tip reached the target in a trial that can be trusted."""
        return self.verdict is not None and self.verdict.hit and not self.refused

    @property
    def observation(self) -> Observation:
        """The trial as estimation sees it."""
        trial, points = self.done["trial"], self.done["points"]
        return Observation(self.name, points.points, points.readings, points.masks, arm=trial.arm)


class Executor(Protocol):
    """The source of the artifacts of steps: a run makes and keeps them (`pipeline.run_folder`), `verify` computes
    them again, `why` asks what has changed."""

    def obtain(self, step: Step) -> Any:
        """The artifact of a step."""

    def publish(self, iterations: list[Iteration]) -> None:
        """Take note that a cast is whole; called after each."""


@dataclass
class History:
    """The iterations of a run so far. hashes: of the content of stored trials, by path."""

    executor: Executor
    iterations: list[Iteration] = field(default_factory=list)
    hashes: Mapping[str, str] = field(default_factory=dict)

    def begin(self, trial: str = "", given: Mapping[str, Any] | None = None) -> Iteration:
        """A new iteration. trial: name of its trial, if it has one. given: artifacts that it begins with."""
        self.iterations.append(Iteration(len(self.iterations) + 1, {}, trial=trial, given=dict(given or {})))
        return self.iterations[-1]

    def make(self, name: str, **given: Any) -> Any:
        """The artifact of a stage in the last iteration. given: artifacts that no stage makes, such as `trials`. Raises
        TypeError for an input of another kind."""
        current, stage = self.iterations[-1], stages()[name]
        current.given.update(given)
        # the stage's inputs as they are now, and where those lie that this run made
        there = [{**one.given, **one.done} for one in self.iterations]
        inputs: dict[str, Any] = {}
        places: list[Path] = []
        for key, asked in stage.inputs.items():
            number, found = asked.found(key, there) or (0, None)
            if number and not isinstance(found, asked.kind):
                raise TypeError(f"stage {stage.name}: {key} is a {type(found).__name__}, not {asked.kind}")
            inputs[key] = found
            if isinstance(found, TrialSet):
                places += [place_of(one, made) for one in found.numbers for made in ("trial", "points")]
            elif number and key in self.iterations[number - 1].done:
                places.append(place_of(number, key))
        step = Step(stage, len(self.iterations), inputs, tuple(places), self.hashes)
        current.done[stage.folder] = self.executor.obtain(step)
        return current.done[stage.folder]
