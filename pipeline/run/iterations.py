"""The iterations of a run, and the steps of which each is made."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from stringcast.data.artifacts import Observation, TrialSet
from stringcast.pipeline.run.file_names import artifact_folder
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.spec import StageSpec

if TYPE_CHECKING:
    from stringcast.stages.hit_test import HitResult  # which loads SciPy


@dataclass(frozen=True)
class Step:
    """A stage to be run in an iteration, from 1. inputs: artifacts, by name. places:
    where those lie that this run made, relative to its folder. hashes: of the content
    of files elsewhere, by path.
    """

    stage: StageSpec
    number: int
    inputs: Mapping[str, Any] = field(repr=False)
    input_folders: tuple[Path, ...] = ()
    file_hashes: Mapping[str, str] = field(default_factory=dict, repr=False)

    @property
    def folder(self) -> Path:
        """The folder of its artifact, relative to the run's."""
        return artifact_folder(self.number, self.stage.folder)

    def derive_seed(self, seed: int) -> int:
        """A seed of its own. seed: the run's."""
        text = f"{seed}/{self.number}/{self.stage.name}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


@dataclass(frozen=True)
class Iteration:
    """One manipulation. done: artifacts that its steps made, given: those that it began
    with, by name. verdict: whether the tip hit. trial: name of its trial, if it is not
    to be called by its number.
    """

    number: int
    artifacts: dict[str, Any] = field(repr=False)
    verdict: HitResult | None = None
    custom_trial_name: str = ""
    given_artifacts: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def trial_name(self) -> str:
        """Name of its trial."""
        return self.custom_trial_name or f"t{self.number:02d}"

    @property
    def refusal_reason(self) -> str:
        """The reason why nothing is learned from its trial; empty if it can be trusted."""
        link = (
            self.artifacts["trial"].link.iloc[0]
            if "trial" in self.artifacts
            else {"valid": True}
        )
        return "" if link["valid"] else str(link["reason"])

    @property
    def has_hit(self) -> bool:
        """Whether the tip reached the target in a trial that can be trusted."""
        return self.verdict is not None and self.verdict.hit and not self.refusal_reason

    @property
    def observation(self) -> Observation:
        """The trial as estimation sees it."""
        trial, points = self.artifacts["trial"], self.artifacts["points"]
        return Observation(
            self.trial_name, points.points, points.readings, points.masks, arm=trial.arm
        )


class Executor(Protocol):
    """The source of the artifacts of steps: a run makes and keeps them
    (`pipeline.run.run_folder`), `verify` computes them again, `why` asks what has
    changed.
    """

    def obtain(self, step: Step) -> Any:
        """The artifact of a step."""

    def publish(self, iterations: list[Iteration]) -> None:
        """Take note that a cast is whole; called after each."""


@dataclass
class History:
    """The iterations of a run so far. hashes: of the content of stored trials, by path."""

    executor: Executor
    iterations: list[Iteration] = field(default_factory=list)
    file_hashes: Mapping[str, str] = field(default_factory=dict)

    def begin_iteration(
        self, trial: str = "", given: Mapping[str, Any] | None = None
    ) -> Iteration:
        """A new iteration. trial: name of its trial, if it has one. given: artifacts
        that it begins with.
        """
        self.iterations.append(
            Iteration(
                len(self.iterations) + 1,
                {},
                custom_trial_name=trial,
                given_artifacts=dict(given or {}),
            )
        )
        return self.iterations[-1]

    def make_artifact(self, name: str, **given: Any) -> Any:
        """The artifact of a stage in the last iteration. given: artifacts that no stage
        makes, such as `trials`. Raises TypeError for an input of another kind.
        """
        current, stage = self.iterations[-1], stages()[name]
        current.given_artifacts.update(given)
        # the stage's inputs as they are now, and where those lie that this run made
        there = [{**one.given_artifacts, **one.artifacts} for one in self.iterations]
        inputs: dict[str, Any] = {}
        places: list[Path] = []
        for key, asked in stage.inputs.items():
            number, found = asked.find(key, there) or (0, None)
            if number and not isinstance(found, asked.kind):
                raise TypeError(
                    f"stage {stage.name}: {key} is a {type(found).__name__}, not {asked.kind}"
                )
            inputs[key] = found
            if isinstance(found, TrialSet):
                places += [
                    artifact_folder(one, made)
                    for one in found.iteration_numbers
                    for made in ("trial", "points")
                ]
            elif number and key in self.iterations[number - 1].artifacts:
                places.append(artifact_folder(number, key))
        step = Step(
            stage, len(self.iterations), inputs, tuple(places), self.file_hashes
        )
        current.artifacts[stage.folder] = self.executor.obtain(step)
        return current.artifacts[stage.folder]
