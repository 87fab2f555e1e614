"""The blind study as one command: benches drawn, diagnosed and scored; pandas and pictures left in the run's folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from omegaconf import OmegaConf
from pydantic import Field

from stringcast.data import dataset, store
from stringcast.data.artifacts import Diagnosis
from stringcast.data.schema import DataError
from stringcast.hardware.virtual.blind import draw
from stringcast.pipeline.experiment import Experiment, prepare
from stringcast.pipeline.inherited import with_inherited_settings
from stringcast.pipeline.modes.study import Study
from stringcast.pipeline.origin import origin
from stringcast.pipeline.settings import build
from stringcast.pipeline.study.benches import study
from stringcast.pipeline.study.pictures import pictures
from stringcast.pipeline.study.scores import TABLES, scores
from stringcast.stages.common import Progress


@dataclass(frozen=True)
class Asked:
    """benches: how many, from seed `first`. processes: 0 is one for each core."""

    benches: Annotated[int, Field(ge=1)]
    first: Annotated[int, Field(ge=0)]
    processes: Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class BlindStudy(Study):
    """Benches that hide a cause: drawn, diagnosed, and only then their envelopes opened."""

    def run(self, experiment: Experiment, folder: Path, progress: Progress) -> str:
        """As of `Study`. What is in `folder` already is not made again."""
        return scored(experiment, folder, progress)


def scored(here: Experiment, folder: Path, progress: Progress) -> str:
    """Draw, diagnose and score; what came out, in a sentence."""
    asked = build(Asked, here.config["study"], "study", "conf/config.yaml")
    seeds = range(asked.first, asked.first + asked.benches)
    drawn, asks = partial(draw, arm=here.arm, camera=here.camera), partial(diagnosed, config=here.config)
    rows = study(seeds, folder, drawn, asks, processes=asked.processes, progress=progress)
    tables = scores(rows)
    for name, frame in tables.items():
        store.write_table(TABLES[name], frame, folder / f"{name}.parquet", origin(here.config, "study", 0, {}))
    pictures(tables, folder)
    return summary(tables)


def diagnosed(folder: Path, config: Mapping[str, Any]) -> Mapping[str, Any]:
    """What diagnosis.json says of a dataset. config: settings of the run, to which the dataset adds its own."""
    said: Mapping[str, Any] = json.loads(diagnosis(folder, config).finding["diagnosis"].iloc[0])
    return said


def diagnosis(folder: Path, config: Mapping[str, Any]) -> Diagnosis:
    """The same with all its tables."""
    mode = {"_target_": "pipeline.modes.Diagnose", "stage": "diagnose", "read": True, "again": False, "first": []}
    asked = OmegaConf.create({**config, "trials": str(folder), "mode": mode | {"motions": 0}})
    settings = with_inherited_settings(asked, set())
    here = prepare(settings, lambda block: f"conf/{block}")
    data = dataset.fits(dataset.read(folder), here.string.length)
    if not data.trials:
        raise DataError(f"{folder}: no trial can be used.")
    trials = list(data.trials.values())
    made: Diagnosis = here.stages["diagnose"](here.model, trials, data.rejected, (), (), seed=here.seed)
    return made


def summary(tables: Mapping[str, pd.DataFrame]) -> str:
    """The study in a few numbers."""
    rates = [
        f"{name}: {right} of {count}" + (f" ({100 * share:.0f} %)" if count else "")
        for name, right, count, share in tables["rates"][["name", "right", "count", "share"]].itertuples(index=False)
    ]
    error, runtime = tables["calibration_error"].iloc[0], tables["runtime"].iloc[0]
    return (
        f"{'; '.join(rates)}. Calibration error {error['error']:.3f} (by chance {error['chance']:.3f}). "
        f"Median runtime {runtime['median']:.0f} s on one core."
    )
