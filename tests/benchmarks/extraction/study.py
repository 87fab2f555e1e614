"""The extraction study: casts filmed under every condition, read, and scored."""

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
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET
from tests.benchmarks.extraction.conditions import CONDITIONS
from tests.benchmarks.extraction.films import (
    ConditionLevel,
    Extract,
    StagedCast,
    perform_cast,
    read_cast,
)
from tests.benchmarks.extraction.scores import (
    FRAMES,
    SHARES,
    compare_frames,
    count_shares,
)
from tests.benchmarks.study import Config, Study, StudyJob

WHERE = "tests/benchmarks/conf/study/extraction.yaml"


@dataclass(frozen=True)
class ExtractionSettings:
    """Settings of the study.

    `casts` is the number for each string, from the run's seed. `frames` is the number
    for each cast. `processes` is 0 for one per core.
    """

    casts: Annotated[int, Field(ge=1)]
    frames: Annotated[int, Field(ge=2)]
    strings: Mapping[str, Any]
    processes: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class ConditionJob(StudyJob):
    """A condition at one severity, under which casts are filmed and read."""

    level: ConditionLevel
    casts: Sequence[StagedCast]
    extract: Extract

    @property
    def name(self) -> str:
        """Name of the result file."""
        return f"{self.level.condition.replace(' ', '_')}-{self.level.severity}"

    def __call__(self) -> list[dict[str, Any]]:
        """Return a row for each frame."""
        frames = []
        for cast in self.casts:
            points, shot = read_cast(cast, self.level, self.extract)
            frames.append(compare_frames(cast, self.level, points, shot))
        return list(pd.concat(frames).to_dict("records"))


@dataclass(frozen=True)
class ExtractionStudy(Study):
    """Casts filmed under every condition, read, and compared with the truth."""

    TABLES: ClassVar = {"frames": FRAMES, "shares": SHARES}
    BLOCK, GROWING = "extraction", ("processes",)

    def jobs(self, config: Config, folder: Path) -> list[ConditionJob]:
        """Return every condition at every severity, of the same casts."""
        settings = build_dataclass(
            ExtractionSettings, config[self.BLOCK], self.BLOCK, WHERE
        )
        experiment = prepare_experiment(config, lambda block: f"conf/{block}")
        casts = []
        for name, block in settings.strings.items():
            specimen = build_dataclass(
                Specimen, block, f"extraction.strings.{name}", WHERE
            )
            for seed in range(experiment.seed, experiment.seed + settings.casts):
                casts.append(
                    perform_cast(
                        name,
                        specimen,
                        experiment.arm,
                        experiment.camera,
                        settings.frames,
                        seed,
                    )
                )
        jobs = []
        for name, severities in CONDITIONS.items():
            for severity, parts in enumerate(severities, start=1):
                level = ConditionLevel(name, severity, parts)
                jobs.append(ConditionJob(level, casts, experiment.stages["extract"]))
        return jobs

    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return table FRAMES, and SHARES counted from it."""
        frames = FRAMES.check(
            pd.DataFrame([row for _, rows in results for row in rows])
        )
        return {"frames": frames, "shares": count_shares(frames)}

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Write shares.png."""
        draw_shares(tables["shares"], folder / "shares.png")

    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return the shares of all frames."""
        frames = tables["frames"]
        read, wrong = frames["read"].mean(), frames["wrong"].mean()
        return f"{len(frames)} frames: {read:.1%} read, {wrong:.2%} wrong, {1 - read:.1%} refused with the reason."


def draw_shares(shares: pd.DataFrame, path: Path) -> None:
    """Draw shares of read, refused and wrong frames, and errors of those read.

    Each condition and severity has its own place. `shares` is table SHARES.
    """
    with plt.style.context(STYLE_SHEET):
        figure, (left, right) = plt.subplots(
            1, 2, figsize=(10, 0.9 + 0.19 * len(shares)), sharey=True
        )
        rows = np.arange(len(shares))[::-1]
        refused = 1 - shares["read"]
        good = shares["read"] - shares["wrong"]
        left.barh(rows, good, color=LIGHT_COLOURS["measured"], label="read")
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
            left=good,
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
