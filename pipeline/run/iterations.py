"""The iterations of a run and their steps."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from stringcast.data.artifacts import Observation, Points, Trial
from stringcast.pipeline.run.file_names import artifact_folder
from stringcast.pipeline.run.stage_graph import StageGraph
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.spec import CollectedTrials, SameIteration, StageSpec

if TYPE_CHECKING:
    from stringcast.stages.hit_test import HitResult  # which loads SciPy

ArtifactT = TypeVar("ArtifactT")
LOOK_NUMBER = 0  # number of the slow trial before the first cast


@dataclass(frozen=True)
class Step:
    """A single execution of a stage in an iteration.

    Parameters
    ----------
    stage : StageSpec
        The stage.
    number : int
        Number of the iteration.
    inputs : mapping
        Artifacts by name.
    input_folders : tuple of Path
        Folders of inputs made by this run, relative to its folder.
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
        Number of a cast or stored trial, from 1; 0 for the look before the first.
    artifacts : dict
        Artifacts made by steps, by name.
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
    def is_look(self) -> bool:
        """Whether it is the slow trial before the first cast."""
        return self.number == LOOK_NUMBER

    @property
    def title(self) -> str:
        """The cast with its number, or the look before the first."""
        return "look at the string" if self.is_look else f"cast {self.number}"

    @property
    def trial_name(self) -> str:
        """Name of the trial."""
        return self.custom_trial_name or f"t{self.number:02d}"

    @property
    def available(self) -> dict[str, Any]:
        """The artifacts that its stages may use, by name."""
        return self.given_artifacts | self.artifacts

    def find(self, kind: type[ArtifactT]) -> ArtifactT | None:
        """Return the newest artifact of a kind, or else a given one."""
        for artifacts in (self.artifacts, self.given_artifacts):
            for artifact in reversed(artifacts.values()):
                if isinstance(artifact, kind):
                    return artifact
        return None

    @property
    def measurement_names(self) -> tuple[str, ...]:
        """Names of its trial and of the points read from it; empty without both."""
        names = []
        for kind in (Trial, Points):
            for name, artifact in self.artifacts.items():
                if isinstance(artifact, kind):
                    names.append(name)
                    break
            else:
                return ()
        return tuple(names)

    @property
    def refusal_reason(self) -> str:
        """Reason why its trial is not used; empty if it is."""
        trial = self.find(Trial)
        if trial is None:
            return ""
        link = trial.link.iloc[0]
        if not link["valid"]:
            return str(link["reason"])
        points = self.find(Points)
        if points is not None and not points.readings["valid"].any():
            return "the string could not be read in any frame"
        return ""

    @property
    def has_hit(self) -> bool:
        """Whether the tip reached the target in a valid trial."""
        return self.verdict is not None and self.verdict.hit and not self.refusal_reason

    @property
    def observation(self) -> Observation:
        """The trial with the newest points."""
        trial, points = self.find(Trial), self.find(Points)
        assert trial is not None
        assert points is not None
        return self.observe(trial, points)

    def observe(self, trial: Trial, points: Points) -> Observation:
        """Return the trial with these points, in the form that estimation takes."""
        return Observation(
            self.trial_name, points.points, points.readings, points.masks, arm=trial.arm
        )


class Executor(Protocol):
    """Source of the artifacts of steps.

    A run makes and stores them, `verify` makes them again and compares.
    """

    def obtain(self, step: Step) -> Any:
        """Return the artifact of a step."""

    def publish(self, iterations: list[Iteration]) -> None:
        """Publish the trials so far; called after each complete cast."""


@dataclass
class History:
    """Iterations of a run so far.

    Parameters
    ----------
    executor : Executor
        Source of the artifacts.
    iterations : list of Iteration
        The iterations.
    file_hashes : mapping
        Content hashes of stored trials by path.
    graph : StageGraph
        Sources of all inputs.
    first_number : int
        Number of the first iteration.
    """

    executor: Executor
    iterations: list[Iteration] = field(default_factory=list)
    file_hashes: Mapping[str, str] = field(default_factory=dict)
    graph: StageGraph = StageGraph()
    first_number: int = 1

    @property
    def next_number(self) -> int:
        """Number of the iteration that begins next."""
        return self.first_number + len(self.iterations)

    def begin_iteration(
        self, trial: str = "", given: Mapping[str, Any] | None = None
    ) -> Iteration:
        """Begin a new iteration and return it.

        `trial` names its trial, if the name is not derived from the number. `given` are
        the artifacts with which it begins, by name.
        """
        iteration = Iteration(
            self.next_number,
            {},
            custom_trial_name=trial,
            given_artifacts=dict(given or {}),
        )
        self.iterations.append(iteration)
        return iteration

    def make_artifact(self, name: str, **given: Any) -> Any:
        """Run a stage in the last iteration and return its artifact.

        `given` are artifacts that no stage makes, such as `trials`. Raises TypeError
        for an input of a wrong type.
        """
        current, stage = self.iterations[-1], stages()[name]
        current.given_artifacts.update(given)
        inputs, folders = self._find_inputs(stage)
        step = Step(stage, current.number, inputs, tuple(folders), self.file_hashes)
        artifact = self.executor.obtain(step)
        current.artifacts[stage.folder] = artifact
        return artifact

    def _find_inputs(self, stage: StageSpec) -> tuple[dict[str, Any], list[Path]]:
        """Find the inputs of a stage in the last iteration, or in earlier ones.

        Returns artifacts by name, and folders of those made by this run.
        """
        available = [iteration.available for iteration in self.iterations]
        inputs: dict[str, Any] = {}
        folders: list[Path] = []
        for name, wanted in stage.inputs.items():
            source = self.graph.artifact_name(stage.name, name)
            found = wanted.find(source, available)
            if found is None:
                inputs[name] = None
                continue
            place, artifact = found
            if not isinstance(artifact, wanted.kind):
                kind = type(artifact).__name__
                raise TypeError(
                    f"stage {stage.name}: {name} is a {kind}, not {wanted.kind}"
                )
            inputs[name] = artifact
            if isinstance(wanted, CollectedTrials):
                sources = self.graph.part_names(stage.name, wanted)
                for number in inputs[name].iteration_numbers:
                    folders += self.folders_of(number, sources)
            else:
                number = self.iterations[place - 1].number
                folders += self.folders_of(number, [source])
        return inputs, folders

    def folders_of(self, number: int, names: Sequence[str]) -> list[Path]:
        """Return the folders of artifacts made by this run in an iteration."""
        artifacts = self.iterations[number - self.first_number].artifacts
        return [artifact_folder(number, name) for name in names if name in artifacts]

    def lacking_input(self, name: str) -> str:
        """Return an input of a stage that the last iteration lacks, or nothing."""
        available = self.iterations[-1].available
        for key, wanted in stages()[name].inputs.items():
            is_needed = type(wanted) is SameIteration
            if is_needed and self.graph.artifact_name(name, key) not in available:
                return key
        return ""

    def observe(self, iteration: Iteration, stage: str) -> Observation:
        """Return the trial of an iteration as it is wired to a stage."""
        trial = self._wired_part(iteration, stage, Trial)
        return iteration.observe(trial, self.wired_points(iteration, stage))

    def wired_points(self, iteration: Iteration, stage: str) -> Points:
        """Return the points of an iteration that are wired to a stage."""
        return self._wired_part(iteration, stage, Points)

    def _wired_part(
        self, iteration: Iteration, stage: str, kind: type[ArtifactT]
    ) -> ArtifactT:
        """Return the artifact wired to a stage, or else the newest of its kind."""
        for wanted in stages()[stage].inputs.values():
            if isinstance(wanted, CollectedTrials):
                for source in self.graph.part_names(stage, wanted):
                    artifact = iteration.available.get(source)
                    if isinstance(artifact, kind):
                        return artifact
        last = iteration.find(kind)
        assert last is not None
        return last


def with_points(observation: Observation, points: Points) -> Observation:
    """Return an observation with other points."""
    return replace(
        observation, points=points.points, readings=points.readings, masks=points.masks
    )
