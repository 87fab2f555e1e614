"""Hold the iterations of a run and the steps of which each consists."""

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
    """A stage that runs in an iteration.

    Parameters
    ----------
    stage : StageSpec
        The stage.
    number : int
        Number of the iteration, from 1.
    inputs : mapping
        Artifacts by name.
    input_folders : tuple of Path
        Folders of the inputs that this run made, relative to its folder.
    file_hashes : mapping
        Content hashes of files elsewhere, by path.
    """

    stage: StageSpec
    number: int
    inputs: Mapping[str, Any] = field(repr=False)
    input_folders: tuple[Path, ...] = ()
    file_hashes: Mapping[str, str] = field(default_factory=dict, repr=False)

    @property
    def folder(self) -> Path:
        """Folder of the artifact, relative to that of the run."""
        return artifact_folder(self.number, self.stage.folder)

    def derive_seed(self, seed: int) -> int:
        """Derive the seed of the step from that of the run."""
        text = f"{seed}/{self.number}/{self.stage.name}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


@dataclass(frozen=True)
class Iteration:
    """One cast, or one stored trial, of a run.

    Parameters
    ----------
    number : int
        Number from 1.
    artifacts : dict
        Artifacts that the steps made, by name.
    verdict : HitResult, optional
        Whether the tip hit.
    custom_trial_name : str
        Name of the trial, if it is not derived from the number.
    given_artifacts : dict
        Artifacts with which the iteration began, by name.
    """

    number: int
    artifacts: dict[str, Any] = field(repr=False)
    verdict: HitResult | None = None
    custom_trial_name: str = ""
    given_artifacts: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def trial_name(self) -> str:
        """Name of the trial."""
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
        """Trial in the form that estimation takes."""
        trial, points = self.artifacts["trial"], self.artifacts["points"]
        return Observation(
            self.trial_name, points.points, points.readings, points.masks, arm=trial.arm
        )


class Executor(Protocol):
    """Source of the artifacts of steps.

    A run makes and stores them, `verify` computes them again, `why` looks for changes.
    """

    def obtain(self, step: Step) -> Any:
        """Return the artifact of a step."""

    def publish(self, iterations: list[Iteration]) -> None:
        """Publish the trials so far; called after each complete cast."""


@dataclass
class History:
    """Iterations of a run so far, with content hashes of stored trials by path."""

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
        """Run a stage in the last iteration and return its artifact.

        Parameters
        ----------
        name : str
            Name of the stage.
        **given : object
            Artifacts that no stage makes, such as `trials`.

        Raises
        ------
        TypeError
            For an input of a wrong type.
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
