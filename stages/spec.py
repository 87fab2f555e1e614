"""The description of a stage, by which the shell finds, runs, stores and shows it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import pandas as pd

from stringcast.data.artifacts import Film, Points, Trial, TrialSet
from stringcast.stages.common import Progress

if TYPE_CHECKING:
    from stringcast.stages.execute.interfaces import Lab
    from stringcast.stages.model.box import Box
    from stringcast.stages.model.model import Model

EXTENDED = "extended.yaml"  # the model that a run made, for `model_from=`
# settings from which the model is made
MODEL = ("arm", "camera", "string", "effects", "parameter_values")

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])
# From settings to numbers of strings, by the setting that decides each
StringCounts = Callable[[Mapping[str, Any]], Mapping[str, float]]
_STRING_COUNTS: dict[Callable[..., Any], StringCounts] = {}


def declare_string_counts(counts: StringCounts) -> Callable[[FunctionT], FunctionT]:
    """Declare how many strings a stage's function simulates; its cost is then known."""

    def register(function: FunctionT) -> FunctionT:
        _STRING_COUNTS[function] = counts
        return function

    return register


def string_counts(
    function: Callable[..., Any], settings: Mapping[str, Any]
) -> Mapping[str, float]:
    """Return the declared numbers of strings; empty if there are none."""
    counts = _STRING_COUNTS.get(function)
    return counts(settings) if counts else {}


@dataclass(frozen=True)
class Input(ABC):
    """An artifact that a stage uses; kind is its class, or several."""

    kind: type | UnionType

    @abstractmethod
    def find(
        self, name: str, iterations: Sequence[Mapping[str, Any]]
    ) -> tuple[int, Any] | None:
        """Find the artifact among those of all iterations.

        Parameters
        ----------
        name : str
            Name of the artifact.
        iterations : sequence of mappings
            Artifacts by name, of each iteration from the first to the current one.

        Returns
        -------
        tuple or None
            Number of its iteration and the artifact; None where there is none and none
            is needed.
        """


class SameIteration(Input):
    """The artifact of the current iteration; LookupError where there is none."""

    def find(
        self, name: str, iterations: Sequence[Mapping[str, Any]]
    ) -> tuple[int, Any] | None:
        """Find the artifact of the current iteration."""
        if name not in iterations[-1]:
            raise LookupError(f"no earlier stage makes `{name}`")
        return len(iterations), iterations[-1][name]


class LatestIteration(Input):
    """The latest artifact of an earlier iteration, if there is one."""

    def find(
        self, name: str, iterations: Sequence[Mapping[str, Any]]
    ) -> tuple[int, Any] | None:
        """Find the latest artifact of an earlier iteration."""
        for number in range(len(iterations) - 1, 0, -1):
            if name in iterations[number - 1]:
                return number, iterations[number - 1][name]
        return None


@dataclass(frozen=True)
class CollectedTrials(SameIteration):
    """The trials that a mode has collected, each from these parts of its iteration.

    parts: kinds of the parts by name, which are wired like inputs.
    """

    kind: type | UnionType = TrialSet
    parts: Mapping[str, type | UnionType] = field(
        default_factory=lambda: {"trial": Trial | Film, "points": Points}
    )


class StageSetup(Protocol):
    """The part of a run that every stage may use in addition to artifacts."""

    @property
    def model(self) -> Model:
        """String, arm and camera with their effects."""

    @property
    def target(self) -> Box:
        """Box that the tip shall enter [m]."""

    @property
    def obstacles(self) -> tuple[Box, ...]:
        """Boxes that arm and string may not touch [m]."""

    @property
    def effects_per_recording(self) -> Sequence[str]:
        """Names of the effects whose values differ between trials."""

    def lab(self, trial: int) -> Lab:
        """Configure arm and camera for the iteration of this number."""


@dataclass(frozen=True)
class StageCall:
    """The call of a stage: its function, setup, seed and progress.

    Parameters
    ----------
    by : the function that its settings name, with these bound; None without settings
    setup : model, target and devices of the run
    seed : of the call's random numbers
    number : of the iteration, from 1; 0 of the look before the first cast
    progress : called with the share that is done
    """

    by: Any
    setup: StageSetup
    seed: int
    number: int
    progress: Progress


@dataclass(frozen=True)
class StageSummary:
    """The terminal's summary of an artifact: a heading, a sentence, and a table."""

    title: str
    sentence: str
    table: pd.DataFrame


def _default_summary(artifact: Any) -> StageSummary:
    """Summarise an artifact by the numbers of rows of its tables."""
    counts = {name: len(getattr(artifact, name)) for name in artifact.TABLES}
    rows = pd.DataFrame({"table": counts.keys(), "rows": counts.values()})
    return StageSummary(type(artifact).__name__, f"Made {', '.join(counts)}.", rows)


@dataclass(frozen=True)
class StageSpec:
    """The description of a stage; functions named as text are within `stringcast`.

    Parameters
    ----------
    name : of the stage and, where it has one, of its group of settings
    makes : class of its artifact, a dataclass of tables (see `data.artifacts`)
    folder : of the artifact within an iteration, and its name for later stages
    uses : settings that decide the result; a new value makes it out of date
    run : function from a `StageCall` and the inputs, by name, to the artifact
    inputs : by the names of artifacts
    by : functions that `_target_` of its settings may name
    summary : function from the artifact to its summary in the terminal
    files : function from the artifact and the folder of the next iteration to texts
        that a run leaves in its folder, by name
    page : function that makes report.html from `report.records.StageRecord`
    is_end : its artifact is a result, even where no stage uses it
    moves_arm : it performs a motion, real or virtual
    """

    name: str
    makes: type
    folder: str
    uses: tuple[str, ...]
    run: str
    inputs: Mapping[str, Input] = field(default_factory=dict)
    by: tuple[str, ...] = ()
    summary: Callable[[Any], StageSummary] = _default_summary
    files: Callable[[Any, Path], Mapping[str, str]] = lambda artifact, ahead: {}
    page: str = "stages.report.pages.tables.tables_page"
    is_end: bool = False
    moves_arm: bool = False

    @property
    def collected_input(self) -> str:
        """Name of the input that takes collected trials; empty without one."""
        for name, wanted in self.inputs.items():
            if isinstance(wanted, CollectedTrials):
                return name
        return ""

    @property
    def takes_frames(self) -> bool:
        """Whether an input takes the frames of a trial."""
        return any(issubclass(Film, wanted.kind) for wanted in self.inputs.values())
