"""The extraction study: every condition filmed, read and scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pandas as pd
from pydantic import Field

from stringcast.hardware.virtual import Specimen
from stringcast.hardware.virtual.conditions import CONDITIONS
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.settings import build
from stringcast.pipeline.studies.engine import Study, StudyJob
from stringcast.pipeline.studies.extraction.films import Cell, Extract, Take, read, take
from stringcast.pipeline.studies.extraction.pictures import overview
from stringcast.pipeline.studies.extraction.scores import FRAMES, SHARES, compared, shares

WHERE = "conf/experiment/extraction_study.yaml"


@dataclass(frozen=True)
class ExtractionSettings:
    """casts: of each string, from the run's seed. frames: of each cast. strings: specimens by name. processes: 0 is one
    for each core."""

    casts: Annotated[int, Field(ge=1)]
    frames: Annotated[int, Field(ge=2)]
    strings: Mapping[str, Any]
    processes: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class OneCondition(StudyJob):
    """A condition at one severity, under which casts are filmed and read. extract: the stage, with its settings."""

    cell: Cell
    takes: Sequence[Take]
    extract: Extract

    @property
    def name(self) -> str:
        return f"{self.cell.condition.replace(' ', '_')}-{self.cell.severity}"

    def __call__(self) -> list[dict[str, Any]]:
        """A row for each frame."""
        made = [compared(take, self.cell, *read(take, self.cell, self.extract)) for take in self.takes]
        return list(pd.concat(made).to_dict("records"))


@dataclass(frozen=True)
class ExtractionStudy(Study):
    """Casts rendered under every condition, read, and compared with what was really so."""

    KIND = "study"
    TABLES: ClassVar = {"frames": FRAMES, "shares": SHARES}
    BLOCK, MORE = "extraction_study", ("processes",)

    def jobs(self, experiment: Experiment, folder: Path) -> list[OneCondition]:
        """Every condition at every severity, of the same casts."""
        asked = build(ExtractionSettings, experiment.config[self.BLOCK], self.BLOCK, WHERE)
        seeds = range(experiment.seed, experiment.seed + asked.casts)
        takes = []
        for name, block in asked.strings.items():
            specimen = build(Specimen, block, f"extraction_study.strings.{name}", WHERE)
            takes += [take(name, specimen, experiment.arm, experiment.camera, asked.frames, seed) for seed in seeds]
        return [OneCondition(cell, takes, experiment.stages["extract"]) for cell in cells()]

    def tables(self, experiment: Experiment, made: Sequence[tuple[Any, Any]]) -> Mapping[str, pd.DataFrame]:
        frames = FRAMES.check(pd.DataFrame([row for _, rows in made for row in rows]))
        return {"frames": frames, "shares": shares(frames)}

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        overview(tables["shares"], folder / "shares.png")

    def sentence(self, tables: Mapping[str, pd.DataFrame]) -> str:
        frames = tables["frames"]
        read, wrong = frames["read"].mean(), frames["wrong"].mean()
        return f"{len(frames)} frames: {read:.1%} read, {wrong:.2%} wrong, {1 - read:.1%} refused with the reason."


def cells() -> list[Cell]:
    """Every condition at every severity."""
    return [
        Cell(name, severity, parts)
        for name, severities in CONDITIONS.items()
        for severity, parts in enumerate(severities, start=1)
    ]
