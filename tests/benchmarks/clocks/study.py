"""The clocks study: offsets of clocks of synthetic recordings, estimated and scored."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.schema import Table, parse_columns
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.model_settings import build_string
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.clock.fit import shift_observations
from stringcast.stages.clock.offset import estimate_clock_offset, find_wrong_clock
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.model import Model
from tests.benchmarks.clocks.recordings import Circumstances, draw_recording
from tests.benchmarks.study import Config, Study, StudyJob

WHERE = "tests/benchmarks/conf/study/clocks.yaml"
WRONG_RANGE_S = (0.05, 0.3)  # by which a clock is wrong that is to be refused
OFFSETS = Table(
    "offsets",
    "a row for each recording: what was hidden and what was found",
    parse_columns("""
    seed [1] (int): of string, motions, noise and clock
    simulator (text): that made the measurements
    motion (text): slow or cast
    points [1] (int): number of tracked points of the string
    cause (text): that is hidden; empty if there is none
    trials [1] (int): number of trials
    fps [1/s]: frames per second
    sigma [m]: noise of a coordinate
    hidden [s]: arm's clock less the camera's
    found [s]: what was found
    low [s]: lower end of the 95 % interval
    high [s]: upper end of the 95 % interval
    is_common [1] (bool): whether all trials were found to agree
    wrong_by [s]: by which a clock without statement was made wrong
    is_refused [1] (bool): whether that was refused
    runtime [s]: processor time of the estimate
    """),
)


@dataclass(frozen=True)
class ClocksSettings:
    """Settings of the study.

    `recordings` is their number, from seed `first`. `processes` is 0 for one per core.
    """

    recordings: Annotated[int, Field(ge=1)]
    first: Annotated[int, Field(ge=0)]
    processes: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class RecordingJob(StudyJob):
    """The recording of a seed, drawn, estimated, and made wrong."""

    seed: int
    string_block: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Name of the result file."""
        return f"{self.seed:05d}"

    def __call__(self) -> dict[str, Any]:
        """Return the row."""
        circumstances = Circumstances.of_seed(self.seed)
        recording = draw_recording(circumstances)
        block = {**self.string_block, "length": recording.length}
        string = build_string(block, "conf/string")
        camera = Camera(64, 64, 30.0, (32.0, 32.0), fps=recording.fps)
        model = Model(string, recording.arm, camera)
        observations = recording.observations
        started = time.process_time()
        clock = estimate_clock_offset(model, observations, np.random.default_rng(0))
        runtime = time.process_time() - started

        rng = np.random.default_rng([self.seed, 58])
        wrong_by = float(rng.uniform(*WRONG_RANGE_S) * rng.choice([-1.0, 1.0]))
        names = [observation.trial for observation in observations]
        added = dict.fromkeys(names, recording.offset - wrong_by)
        wrong = shift_observations(observations, added)
        refusal = find_wrong_clock(model, wrong, np.random.default_rng(0))
        first = next(iter(clock.by_trial.values()))
        return {
            "seed": self.seed,
            "simulator": circumstances.simulator,
            "motion": circumstances.motion,
            "points": circumstances.points,
            "cause": recording.cause,
            "trials": len(observations),
            "fps": recording.fps,
            "sigma": recording.sigma,
            "hidden": recording.offset,
            "found": first.value,
            "low": first.low,
            "high": first.high,
            "is_common": clock.is_common,
            "wrong_by": wrong_by,
            "is_refused": refusal is not None,
            "runtime": runtime,
            "code": code_state()["commit"],
        }


@dataclass(frozen=True)
class ClocksStudy(Study):
    """Synthetic recordings with two clocks, and what is found of their offset."""

    TABLES: ClassVar = {"offsets": OFFSETS}
    BLOCK, GROWING = "clocks", ("recordings", "first", "processes")

    def jobs(self, config: Config, folder: Path) -> list[RecordingJob]:
        """Return a recording for each seed."""
        settings = build_dataclass(
            ClocksSettings, config[self.BLOCK], self.BLOCK, WHERE
        )
        seeds = range(settings.first, settings.first + settings.recordings)
        return [RecordingJob(seed, config["string"]) for seed in seeds]

    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return table OFFSETS."""
        rows = pd.DataFrame([row for _, row in results])
        return {"offsets": rows[[column.name for column in OFFSETS.columns]]}

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Draw nothing: the table is small."""

    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return rates by kind of motion."""
        sentences = []
        for motion, rows in tables["offsets"].groupby("motion"):
            is_inside = rows["hidden"].between(rows["low"], rows["high"])
            width = (rows["high"] - rows["low"]) * rows["fps"]
            error_ms = 1e3 * (rows["found"] - rows["hidden"]).abs().median()
            sentences.append(
                f"{motion}: {is_inside.sum()} of {len(rows)} offsets inside; width "
                f"{width.median():.1f} frames in the median, {width.max():.1f} at "
                f"most; median error {error_ms:.2f} ms; wrong clocks refused: "
                f"{rows['is_refused'].sum()} of {len(rows)}."
            )
        runtime = tables["offsets"]["runtime"].median()
        return " ".join([*sentences, f"Median processor time {runtime:.1f} s."])
