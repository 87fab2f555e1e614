"""The measured study: every set of effects fitted to every string.

Each fit is kept as an ordinary run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pandas as pd
from omegaconf import OmegaConf
from pydantic import Field

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.run.provenance import code_state, step_origin
from stringcast.pipeline.run.single_run import perform_run
from stringcast.pipeline.settings.composition import UserError, compose_settings
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from tests.benchmarks.measured.family import Family
from tests.benchmarks.measured.pictures import draw_sets
from tests.benchmarks.measured.scores import SETS, predicted_points, score_fit
from tests.benchmarks.study import Config, Study, StudyJob

WHERE = "tests/benchmarks/conf/study/measured.yaml"


@dataclass(frozen=True)
class MeasuredSettings:
    """Settings of the study.

    `source` is the folder of all families. `processes` is 0 for one per core. `strings`
    holds names, and is empty for all.
    """

    source: str
    processes: Annotated[int, Field(ge=0)]
    strings: list[str]
    families: dict[str, Family]


@dataclass(frozen=True)
class FitJob(StudyJob):
    """A set of effects and the string that it is fitted to.

    `config` holds the settings of the study, `folder` is the study's folder.
    """

    family: str
    string: str
    effect_set: str
    config: Mapping[str, Any]
    folder: Path

    @property
    def name(self) -> str:
        """Name of the result file."""
        return f"{self.string}-{self.effect_set.replace(' ', '_')}"

    def __call__(self) -> dict[str, Any]:
        """Fit in this process alone and return the row."""
        run = run_folder(self.folder, self.string, self.effect_set)
        is_new = not (run / "iterations").exists()
        dataset = self.folder / "datasets" / self.string
        experiment = prepare_experiment(
            fit_settings(self, dataset), lambda block: f"conf/{block}"
        )
        result = perform_run(experiment, run, Terminal(quiet=True))
        block = self.config["measured"]["families"][self.family]
        family = build_dataclass(
            Family, block, f"measured.families.{self.family}", WHERE
        )
        times = os.times()
        commit = code_state()["commit"]
        return {
            "string": self.string,
            "laws": self.effect_set,
            "effects": ", ".join(family.sets[self.effect_set]["effects"]),
            **score_fit(experiment, result),
            "authors_tip": family.authors.get(self.string),
            "cpu": times.user + times.system if is_new else None,
            "code": commit[:7] + commit[40:],
        }


def run_folder(folder: Path, string: str, effect_set: str) -> Path:
    """Return the run folder of a fit.

    `folder` is the study's.
    """
    return folder / "fits" / f"{string}-{effect_set.replace(' ', '_')}"


@dataclass(frozen=True)
class MeasuredStudy(Study):
    """Strings that others measured, fitted with stated sets of effects."""

    TABLES: ClassVar = {"sets": SETS}
    BLOCK, GROWING = "measured", ("strings", "processes")
    CALLS_PER_PROCESS = 1  # so that the processor time of a row is that of its own fit

    def jobs(self, config: Config, folder: Path) -> list[FitJob]:
        """Write the datasets of all strings, and return the fits of all sets."""
        settings = build_dataclass(
            MeasuredSettings, config[self.BLOCK], self.BLOCK, WHERE
        )
        source = Path(settings.source)
        trials = {
            name: family.trials_by_string(source)
            for name, family in settings.families.items()
        }
        known = [string for strings in trials.values() for string in strings]
        if unknown := set(settings.strings) - set(known):
            names = ", ".join(sorted(unknown))
            raise UserError(
                "measured.strings",
                f"there is no {names}; there are {', '.join(known)}",
            )
        made_by = step_origin({"measured": config["measured"]}, "dataset", 0, {})
        jobs = []
        for name, family in settings.families.items():
            for string in trials[name]:
                if settings.strings and string not in settings.strings:
                    continue
                family.write(
                    source,
                    string,
                    trials[name][string],
                    folder / "datasets" / string,
                    made_by,
                )
                jobs += [
                    FitJob(name, string, effect_set, config, folder)
                    for effect_set in family.sets
                ]
        return jobs

    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return table SETS."""
        names = [column.name for column in SETS.columns]
        return {
            "sets": SETS.check(pd.DataFrame([row for _, row in results], columns=names))
        }

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Write sets.png."""
        sets = tables["sets"]
        predictions = {}
        for string, effect_set in zip(sets["string"], sets["laws"], strict=True):
            predictions[string, effect_set] = predicted_points(
                run_folder(folder, string, effect_set)
            )
        draw_sets(sets, predictions, folder / "sets.png")

    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return the range of errors of the best set of each string."""
        sets = tables["sets"]
        best = sets.loc[sets.groupby("string", sort=False)["tip"].idxmin()]
        fitted = millimetre_range(best["tip"])
        held_out = millimetre_range(best["held_out_tip"].dropna())
        return (
            f"{len(sets)} sets of effects on {len(best)} strings. The best set of each string has a tip error of "
            f"{fitted} mm in fitted trials, {held_out} mm in held-out trials."
        )


def millimetre_range(values: pd.Series) -> str:
    """Return the range of values [m] in words."""
    return (
        f"{1e3 * values.min():.1f} to {1e3 * values.max():.1f}" if len(values) else "no"
    )


def fit_settings(job: FitJob, dataset: Path) -> dict[str, Any]:
    """Return the settings of a run `+experiment=estimate trials=<dataset>`.

    Those of the family and the set are merged in.
    """
    family = job.config["measured"]["families"][job.family]
    settings = (
        compose_settings(["+experiment=estimate"])
        | family["settings"]
        | family["sets"][job.effect_set]
    )
    settings |= {
        "seed": job.config["seed"],
        "saved_outputs": [],
        "trials": str(dataset),
    }
    return inherit_settings(OmegaConf.create(settings), {"string"})
