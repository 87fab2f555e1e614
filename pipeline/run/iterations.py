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
    """A cast of a run, or a stored trial that a run uses.

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
        """Reason why its trial cannot be trusted; empty if it can."""
        if "trial" not in self.artifacts:
            return ""
        link = self.artifacts["trial"].link.iloc[0]
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
        """Begin a new iteration and return it.

        Parameters
        ----------
        trial : str
            Name of its trial, if it is not derived from the number.
        given : mapping, optional
            Artifacts with which it begins, by name.
        """
        iteration = Iteration(
            len(self.iterations) + 1,
            {},
            custom_trial_name=trial,
            given_artifacts=dict(given or {}),
        )
        self.iterations.append(iteration)
        return iteration

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
        available = []
        for iteration in self.iterations:
            available.append(iteration.given_artifacts | iteration.artifacts)

        inputs: dict[str, Any] = {}
        folders: list[Path] = []
        for key, wanted in stage.inputs.items():
            number, artifact = wanted.find(key, available) or (0, None)
            inputs[key] = artifact
            if number and not isinstance(artifact, wanted.kind):
                kind = type(artifact).__name__
                raise TypeError(f"stage {name}: {key} is a {kind}, not {wanted.kind}")
            if isinstance(artifact, TrialSet):
                for trial_number in artifact.iteration_numbers:
                    folders.append(artifact_folder(trial_number, "trial"))
                    folders.append(artifact_folder(trial_number, "points"))
            elif number and key in self.iterations[number - 1].artifacts:
                folders.append(artifact_folder(number, key))
        step = Step(stage, current.number, inputs, tuple(folders), self.file_hashes)
        artifact = self.executor.obtain(step)
        current.artifacts[stage.folder] = artifact
        return artifact
