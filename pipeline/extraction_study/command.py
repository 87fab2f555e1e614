"""The extraction study as one command: every condition filmed, read and scored; tables kept on disk as they come."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field

from stringcast.data import store
from stringcast.hardware.virtual import Specimen
from stringcast.hardware.virtual.conditions import CONDITIONS
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.extraction_study.films import Cell, Take, read, take
from stringcast.pipeline.extraction_study.pictures import overview
from stringcast.pipeline.extraction_study.scores import FRAMES, SHARES, compared, shares
from stringcast.pipeline.modes.study import Study
from stringcast.pipeline.origin import origin
from stringcast.pipeline.settings import build
from stringcast.stages.common import Progress

WHERE = "conf/experiment/extraction_study.yaml"


@dataclass(frozen=True)
class Asked:
    """casts: of each string, from the run's seed. frames: of each cast. strings: specimens by name."""

    casts: Annotated[int, Field(ge=1)]
    frames: Annotated[int, Field(ge=2)]
    strings: Mapping[str, Any]


@dataclass(frozen=True)
class ExtractionStudy(Study):
    """Casts rendered under every condition, read, and compared with what was really so."""

    def run(self, experiment: Experiment, folder: Path, progress: Progress) -> str:
        """As of `Study`. What is in `folder` already is not made again."""
        return scored(experiment, folder, progress)


def scored(here: Experiment, folder: Path, progress: Progress) -> str:
    """Film, read and score; what came out, in a sentence."""
    asked = build(Asked, here.config["extraction_study"], "extraction_study", WHERE)
    takes = [one for name, block in asked.strings.items() for one in _takes(here, asked, name, block)]
    tables = []
    for number, cell in enumerate(cells()):
        tables.append(_kept(here, folder, cell, takes))
        progress((number + 1) / len(cells()))
    frames = pd.concat(tables, ignore_index=True)
    summed = shares(frames)
    store.write_table(FRAMES, frames, folder / "frames.parquet", origin(here.config, "study", 0, {}))
    store.write_table(SHARES, summed, folder / "shares.parquet", origin(here.config, "study", 0, {}))
    overview(summed, folder / "shares.png")
    return sentence(frames)


def cells() -> list[Cell]:
    """Every condition at every severity."""
    return [
        Cell(name, severity, parts)
        for name, severities in CONDITIONS.items()
        for severity, parts in enumerate(severities, start=1)
    ]


def sentence(frames: pd.DataFrame) -> str:
    """The study in a few numbers."""
    read, wrong = frames["read"].mean(), frames["wrong"].mean()
    return f"{len(frames)} frames: {read:.1%} read, {wrong:.2%} wrong, {1 - read:.1%} refused with the reason."


def _takes(here: Experiment, asked: Asked, name: str, block: Mapping[str, Any]) -> list[Take]:
    """The casts of one string."""
    specimen = build(Specimen, block, f"extraction_study.strings.{name}", WHERE)
    seeds = range(here.seed, here.seed + asked.casts)
    return [take(name, specimen, here.arm, here.camera, asked.frames, seed) for seed in seeds]


def _kept(here: Experiment, folder: Path, cell: Cell, takes: list[Take]) -> pd.DataFrame:
    """Table FRAMES of one condition and severity, read from `folder` if it is there."""
    path = folder / "conditions" / f"{cell.condition.replace(' ', '_')}-{cell.severity}.parquet"
    if not path.exists():
        made = [compared(one, cell, *read(one, cell, here.stages["extract"])) for one in takes]
        store.write_table(FRAMES, pd.concat(made, ignore_index=True), path, origin(here.config, "study", 0, {}))
    return pd.read_parquet(path)
