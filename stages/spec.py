"""The description of a stage: `STAGE`, by which the shell finds, runs, stores and shows
it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Protocol

import pandas as pd

from stringcast.stages.common import Progress

if TYPE_CHECKING:
    from stringcast.stages.execute.interfaces import Lab
    from stringcast.stages.model.box import Box
    from stringcast.stages.model.model import Model

EXTENDED = "extended.yaml"  # the model that a run made, for `model_from=`
# settings of which the model is made
MODEL = ("arm", "camera", "string", "effects", "parameter_values")


@dataclass(frozen=True)
class Input(ABC):
    """An artifact that a stage looks at. kind: its class, or several."""

    kind: type | UnionType

    @abstractmethod
    def find(
        self, name: str, iterations: Sequence[Mapping[str, Any]]
    ) -> tuple[int, Any] | None:
        """Number of its iteration and the artifact; None where there is none, and none
        is needed.

        iterations: artifacts by name, of each iteration from the first; the last is the
        one that is made now.
        """


class SameIteration(Input):
    """The artifact of the same iteration. Raises LookupError where there is none."""

    def find(
        self, name: str, iterations: Sequence[Mapping[str, Any]]
    ) -> tuple[int, Any] | None:
        if name not in iterations[-1]:
            raise LookupError(f"no stage before it makes `{name}`")
        return len(iterations), iterations[-1][name]


class LatestIteration(Input):
    """The latest of an earlier iteration, if there is one."""

    def find(
        self, name: str, iterations: Sequence[Mapping[str, Any]]
    ) -> tuple[int, Any] | None:
        earlier = enumerate(iterations[:-1], start=1)
        return next(
            (
                (number, made[name])
                for number, made in reversed([*earlier])
                if name in made
            ),
            None,
        )


class StageSetup(Protocol):
    """The part of a run that every stage may use beside artifacts. own: effects whose
    values differ from trial to trial.
    """

    @property
    def model(self) -> Model: ...
    @property
    def target(self) -> Box: ...
    @property
    def obstacles(self) -> tuple[Box, ...]: ...
    @property
    def effects_per_recording(self) -> Sequence[str]: ...

    def lab(self, trial: int) -> Lab:
        """Arm and camera, as configured. trial: number of the iteration."""


@dataclass(frozen=True)
class StageCall:
    """One call of a stage. by: the function that its settings name, with these bound;
    of a stage without settings, nothing. number: of the iteration, from 1.
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


def _default_summary(made: Any) -> StageSummary:
    """The summary of a stage without one of its own: the number of rows it made."""
    counts = {name: len(getattr(made, name)) for name in made.TABLES}
    rows = pd.DataFrame({"table": counts.keys(), "rows": counts.values()})
    return StageSummary(type(made).__name__, f"Made {', '.join(counts)}.", rows)


@dataclass(frozen=True)
class StageSpec:
    """name: of the stage and, where it has one, of its group of settings. makes: its
    artifact's class, a dataclass of tables (`data.artifacts`). folder: of the artifact
    within an iteration, and the artifact's name for stages after it. uses: settings
    that decide what comes out. run: a function from a `Call` and the inputs, by name,
    to the artifact. inputs: by the names of artifacts. by: functions that `_target_` of
    its settings may name, if it has settings. Functions that are named as text are
    within `stringcast`.

    summary: what is said of an artifact. files: texts that a run leaves in its folder,
    by name, from the artifact and the folder of the iteration after it. page: the
    function that makes report.html from `report.records.Facts`.
    """

    name: str
    makes: type
    folder: str
    uses: tuple[str, ...]
    run: str
    inputs: Mapping[str, Input] = field(default_factory=dict)
    by: tuple[str, ...] = ()
    summary: Callable[[Any], StageSummary] = _default_summary
    files: Callable[[Any, Path], Mapping[str, str]] = lambda made, ahead: {}
    page: str = "stages.report.pages.tables.tables_page"
