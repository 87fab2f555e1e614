"""The diagnosis study: synthetic datasets that hide a cause, diagnosed and scored."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from omegaconf import OmegaConf
from pydantic import Field

from stringcast.data import dataset
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.schema import DataError
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from tests.benchmarks.diagnosis.pictures import draw_pictures
from tests.benchmarks.diagnosis.scores import TABLES, score_rows
from tests.benchmarks.draw import draw_dataset
from tests.benchmarks.study import Config, Study, StudyJob

FAILED = "failed"  # verdict on a dataset whose diagnosis raised
WHERE = "tests/benchmarks/conf/study/diagnosis.yaml"


@dataclass(frozen=True)
class DiagnosisSettings:
    """Settings of the study.

    `datasets` is their number, from seed `first`. `processes` is 0 for one per core.
    `simulator` is the reference simulator. `kind` applies to all datasets, instead of
    each seed's own.
    """

    datasets: Annotated[int, Field(ge=1)]
    first: Annotated[int, Field(ge=0)]
    processes: Annotated[int, Field(ge=0)]
    simulator: Literal["own_kernel", "nodal", "pyelastica"]
    kind: Literal["none", "effect", "pair", "triple", "outside", "mixed"] | None


@dataclass(frozen=True)
class DatasetJob(StudyJob):
    """The dataset of a seed, drawn and diagnosed."""

    seed: int
    folder: Path
    draw: Callable[[int, Path, Path], None]
    diagnose: Callable[[Path], Mapping[str, Any]]

    @property
    def name(self) -> str:
        """Name of the result file."""
        return f"{self.seed:05d}"

    def __call__(self) -> dict[str, Any]:
        """Return the row.

        A diagnosis that raises is a wrong answer and must not stop the others.
        """
        folder = self.folder / "datasets" / self.name
        truth_file = self.folder / "truth" / f"{self.name}.json"
        truth_file.parent.mkdir(parents=True, exist_ok=True)
        self.draw(self.seed, folder, truth_file)
        started = time.perf_counter()
        try:
            diagnosis = self.diagnose(folder)
        except Exception as error:
            diagnosis = {"verdict": FAILED, "error": f"{type(error).__name__}: {error}"}
        runtime = time.perf_counter() - started
        truth = json.loads(truth_file.read_text(encoding="utf-8"))
        return {
            "seed": self.seed,
            "runtime": runtime,
            "diagnosis": diagnosis,
            "truth": truth,
            "code": code_state()["commit"],
        }


@dataclass(frozen=True)
class DiagnosisStudy(Study):
    """Synthetic datasets, diagnosed and then compared with the ground truth."""

    TABLES = TABLES
    BLOCK, GROWING = "diagnosis", ("datasets", "first", "processes")

    def jobs(self, config: Config, folder: Path) -> list[DatasetJob]:
        """Return a dataset for each seed."""
        settings = build_dataclass(
            DiagnosisSettings, config[self.BLOCK], self.BLOCK, WHERE
        )
        draw = partial(draw_dataset, settings.simulator, kind=settings.kind)
        diagnose = partial(diagnosis_document, config=config)
        seeds = range(settings.first, settings.first + settings.datasets)
        return [DatasetJob(seed, folder, draw, diagnose) for seed in seeds]

    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return table DIAGNOSES and the tables counted from it."""
        return score_rows([row for _, row in results])

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Write confusion.png and overview.png."""
        draw_pictures(tables, folder)

    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return the rates, the calibration error and the runtime."""
        rates = []
        for rate in tables["rates"].itertuples(index=False):
            share = f" ({100 * rate.share:.0f} %)" if rate.count else ""
            rates.append(f"{rate.name}: {rate.right} of {rate.count}{share}")
        error, runtime = tables["calibration_error"].iloc[0], tables["runtime"].iloc[0]
        return (
            f"{'; '.join(rates)}. Calibration error {error['error']:.3f} (by chance {error['chance']:.3f}). "
            f"Median runtime {runtime['median']:.0f} s on one core."
        )


def diagnosis_document(folder: Path, config: Config) -> Mapping[str, Any]:
    """Return the diagnosis.json of a dataset.

    `config` holds the settings of the run; the dataset adds its own.
    """
    diagnosis = diagnose_dataset(folder, config)
    document: Mapping[str, Any] = json.loads(diagnosis.finding["diagnosis"].iloc[0])
    return document


def diagnose_dataset(folder: Path, config: Config) -> Diagnosis:
    """Return the diagnosis of a dataset.

    `config` holds the settings of the run; the dataset adds its own.
    """
    settings = inherit_settings(
        OmegaConf.create({**config, "trials": str(folder)}), set()
    )
    experiment = prepare_experiment(settings, lambda block: f"conf/{block}")
    data = dataset.exclude_stray_points(
        dataset.read_dataset(folder), experiment.string.length
    )
    if not data.trials:
        raise DataError(folder, "no trial can be used")
    trials = list(data.trials.values())
    diagnose = experiment.stages["diagnose"]
    diagnosis: Diagnosis = diagnose(
        experiment.model, trials, data.rejection_reasons, (), (), seed=experiment.seed
    )
    return diagnosis
