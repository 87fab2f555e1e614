"""The blind study: benches drawn, diagnosed and scored."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import pandas as pd
from omegaconf import OmegaConf
from pydantic import Field

from stringcast.data import dataset
from stringcast.data.artifacts import Diagnosis
from stringcast.data.schema import DataError
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.pipeline.studies.blind.pictures import pictures
from stringcast.pipeline.studies.blind.scores import OWN, TABLES, scores
from stringcast.pipeline.studies.engine import Study, StudyJob
from tests.benchmarks.simulators import laboratory
from tests.benchmarks.simulators.blind import LATEST, draw

FAILED = "failed"  # verdict on a bench whose diagnosis raised
HALF = 0.5  # of the trials: what they name, all should name


@dataclass(frozen=True)
class BlindSettings:
    """benches: how many, from seed `first`. processes: 0 is one for each core.
    laboratory: who draws them, the virtual lab itself or one of
    `tests.benchmarks.simulators.laboratory`. kind: of all of a laboratory's, instead of
    each seed's own. replicated: each bench is diagnosed with half of its trials as
    well.
    """

    benches: Annotated[int, Field(ge=1)]
    first: Annotated[int, Field(ge=0)]
    processes: Annotated[int, Field(ge=0)]
    laboratory: Literal["own", "nodal", "pyelastica"] = "own"
    kind: Literal["none", "single", "pair", "triple", "outside"] | None = None
    replicated: bool = False


class Bench(Protocol):
    """A bench with an envelope; see `tests.benchmarks.simulators.blind` and
    `tests.benchmarks.simulators.laboratory`.
    """

    def write(self, folder: Path) -> None:
        """Write what was measured."""

    def envelope(self, path: Path) -> None:
        """Write what is really so."""


@dataclass(frozen=True)
class OneBench(StudyJob):
    """A row of the study: the hidden cause of the bench of a seed, and the diagnosis."""

    seed: int
    folder: Path
    draw: Callable[[int], Bench]
    diagnose: Callable[..., Mapping[str, Any]]
    replicated: bool = False

    @property
    def name(self) -> str:
        return f"{self.seed:05d}"

    def __call__(self) -> dict[str, Any]:
        """The row: one bench must not stop the others, and counts as wrong where the
        diagnosis raises.
        """
        dataset, envelope = (
            self.folder / "datasets" / self.name,
            self.folder / "envelopes" / f"{self.name}.json",
        )
        bench = self.draw(self.seed)
        bench.write(dataset)
        bench.envelope(envelope)
        begun = time.perf_counter()
        said = self._said(dataset, 1.0)
        row = {
            "seed": self.seed,
            "runtime": time.perf_counter() - begun,
            "diagnosis": said,
        }
        if self.replicated:
            row["half"] = self._said(dataset, HALF)
        truth = json.loads(envelope.read_text(encoding="utf-8"))
        return row | {
            "truth": truth,
            "version": truth.get("version", LATEST),
            "code": code_state()["commit"],
        }

    def _said(self, dataset: Path, share: float) -> Mapping[str, Any]:
        try:
            return self.diagnose(dataset, share=share)
        except Exception as error:
            return {"verdict": FAILED, "error": f"{type(error).__name__}: {error}"}


@dataclass(frozen=True)
class BlindStudy(Study):
    """Benches that hide a cause: drawn, diagnosed, and only then their envelopes
    opened.
    """

    KIND = "study"
    TABLES = TABLES
    BLOCK, MORE = "study", ("benches", "first", "processes")

    def jobs(self, experiment: Experiment, folder: Path) -> list[OneBench]:
        """A bench for each seed."""
        asked = build_dataclass(
            BlindSettings, experiment.config[self.BLOCK], self.BLOCK, "conf/config.yaml"
        )
        drawn: Callable[[int], Bench] = partial(
            draw, arm=experiment.arm, camera=experiment.camera
        )
        if asked.laboratory != OWN:
            drawn = partial(laboratory.drawn, asked.laboratory, kind=asked.kind)
        asks = partial(diagnosed, config=experiment.config)
        seeds = range(asked.first, asked.first + asked.benches)
        return [OneBench(seed, folder, drawn, asks, asked.replicated) for seed in seeds]

    def tables(
        self, experiment: Experiment, made: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        return scores([row for _, row in made])

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        pictures(tables, folder)

    def sentence(self, tables: Mapping[str, pd.DataFrame]) -> str:
        counted = tables["rates"][["name", "right", "count", "share"]]
        rates = [
            f"{name}: {right} of {count}" + (f" ({100 * share:.0f} %)" if count else "")
            for name, right, count, share in counted.itertuples(index=False)
        ]
        error, runtime = tables["calibration_error"].iloc[0], tables["runtime"].iloc[0]
        return (
            f"{'; '.join(rates)}. Calibration error {error['error']:.3f} (by chance {error['chance']:.3f}). "
            f"Median runtime {runtime['median']:.0f} s on one core."
        )


def diagnosed(
    folder: Path, config: Mapping[str, Any], share: float = 1.0
) -> Mapping[str, Any]:
    """The diagnosis.json of the first trials of a dataset, such a share of them.
    config: settings of the run, to which the dataset adds its own.
    """
    said: Mapping[str, Any] = json.loads(
        diagnosis(folder, config, share).finding["diagnosis"].iloc[0]
    )
    return said


def diagnosis(folder: Path, config: Mapping[str, Any], share: float = 1.0) -> Diagnosis:
    """The diagnosis of the first trials of a dataset, such a share of them, with all
    its tables.
    """
    mode = {
        "_target_": "pipeline.modes.Diagnose",
        "stage": "diagnose",
        "read": True,
        "again": False,
        "first": [],
    }
    asked = OmegaConf.create(
        {**config, "trials": str(folder), "mode": mode | {"motions": 0}}
    )
    settings = inherit_settings(asked, set())
    here = prepare_experiment(settings, lambda block: f"conf/{block}")
    data = dataset.exclude_stray_points(
        dataset.read_dataset(folder), here.string.length
    )
    if not data.trials:
        raise DataError(f"{folder}: no trial can be used.")
    trials = list(data.trials.values())[: math.ceil(share * len(data.trials))]
    made: Diagnosis = here.stages["diagnose"](
        here.model, trials, data.rejection_reasons, (), (), seed=here.seed
    )
    return made
