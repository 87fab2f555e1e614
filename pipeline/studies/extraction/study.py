"""The extraction study: every condition filmed, read and scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.hardware.virtual import Specimen
from stringcast.hardware.virtual.conditions import CONDITIONS
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.pipeline.studies.engine import Study, StudyJob
from stringcast.pipeline.studies.extraction.films import Cell, Extract, Take, read, take
from stringcast.pipeline.studies.extraction.scores import (
    FRAMES,
    SHARES,
    compared,
    shares,
)
from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET

WHERE = "conf/experiment/extraction_study.yaml"


@dataclass(frozen=True)
class ExtractionSettings:
    """casts: of each string, from the run's seed. frames: of each cast. strings:
    specimens by name. processes: 0 is one for each core.
    """

    casts: Annotated[int, Field(ge=1)]
    frames: Annotated[int, Field(ge=2)]
    strings: Mapping[str, Any]
    processes: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class OneCondition(StudyJob):
    """A condition at one severity, under which casts are filmed and read. extract: the
    stage, with its settings.
    """

    cell: Cell
    takes: Sequence[Take]
    extract: Extract

    @property
    def name(self) -> str:
        return f"{self.cell.condition.replace(' ', '_')}-{self.cell.severity}"

    def __call__(self) -> list[dict[str, Any]]:
        """A row for each frame."""
        made = [
            compared(take, self.cell, *read(take, self.cell, self.extract))
            for take in self.takes
        ]
        return list(pd.concat(made).to_dict("records"))


@dataclass(frozen=True)
class ExtractionStudy(Study):
    """Casts rendered under every condition, read, and compared with what was really so."""

    KIND = "study"
    TABLES: ClassVar = {"frames": FRAMES, "shares": SHARES}
    BLOCK, MORE = "extraction_study", ("processes",)

    def jobs(self, experiment: Experiment, folder: Path) -> list[OneCondition]:
        """Every condition at every severity, of the same casts."""
        asked = build_dataclass(
            ExtractionSettings, experiment.config[self.BLOCK], self.BLOCK, WHERE
        )
        seeds = range(experiment.seed, experiment.seed + asked.casts)
        takes = []
        for name, block in asked.strings.items():
            specimen = build_dataclass(
                Specimen, block, f"extraction_study.strings.{name}", WHERE
            )
            takes += [
                take(
                    name,
                    specimen,
                    experiment.arm,
                    experiment.camera,
                    asked.frames,
                    seed,
                )
                for seed in seeds
            ]
        return [
            OneCondition(
                Cell(name, severity, parts), takes, experiment.stages["extract"]
            )
            for name, severities in CONDITIONS.items()
            for severity, parts in enumerate(severities, start=1)
        ]

    def tables(
        self, experiment: Experiment, made: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        frames = FRAMES.check(pd.DataFrame([row for _, rows in made for row in rows]))
        return {"frames": frames, "shares": shares(frames)}

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        overview(tables["shares"], folder / "shares.png")

    def sentence(self, tables: Mapping[str, pd.DataFrame]) -> str:
        frames = tables["frames"]
        read, wrong = frames["read"].mean(), frames["wrong"].mean()
        return f"{len(frames)} frames: {read:.1%} read, {wrong:.2%} wrong, {1 - read:.1%} refused with the reason."


def overview(shares: pd.DataFrame, path: Path) -> None:
    """Draw what was read, refused and wrong under each condition and severity, and how
    far off what was read is.

    shares: table SHARES.
    """
    with plt.style.context(STYLE_SHEET):
        figure, (left, right) = plt.subplots(
            1, 2, figsize=(10, 0.9 + 0.19 * len(shares)), sharey=True
        )
        rows = np.arange(len(shares))[::-1]
        refused = 1 - shares["read"]
        left.barh(
            rows,
            shares["read"] - shares["wrong"],
            color=LIGHT_COLOURS["measured"],
            label="read",
        )
        left.barh(
            rows,
            refused,
            left=1 - refused,
            color=LIGHT_COLOURS["grid"],
            label="refused",
        )
        left.barh(
            rows,
            shares["wrong"],
            left=shares["read"] - shares["wrong"],
            color=LIGHT_COLOURS["before"],
            label="wrong",
        )
        left.set_yticks(
            rows, shares["condition"] + " " + shares["severity"].astype(str)
        )
        left.set(xlabel="share of frames", xlim=(0, 1), ylim=(-0.7, len(shares) - 0.3))
        left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        for name, label, colour in (
            ("line_px", "line", "after"),
            ("tip_px", "tip", "target"),
        ):
            right.plot(
                shares[name],
                rows,
                "o",
                ms=4,
                color=LIGHT_COLOURS[colour],
                label=f"{label}, median",
            )
            right.plot(
                shares[f"{name}_95"],
                rows,
                "|",
                ms=8,
                color=LIGHT_COLOURS[colour],
                label=f"{label}, 95 %",
            )
        right.axvline(3, color=LIGHT_COLOURS["wall"], ls="--", lw=1)
        right.set(
            xlabel="error of what was read / px; beyond the dashed line it is wrong",
            xscale="log",
        )
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
        figure.savefig(path, dpi=90, facecolor="white")
        plt.close(figure)
