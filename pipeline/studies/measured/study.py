"""Every set of effects fitted to every string, each in a process of its own and kept as
an ordinary run.
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
from stringcast.pipeline.modes.stepwise import require_trials
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.provenance import code_state, step_origin
from stringcast.pipeline.run.single_run import perform_run
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import (
    UserError,
    build_dataclass,
    compose_settings,
)
from stringcast.pipeline.studies.engine import Study, StudyJob
from stringcast.pipeline.studies.measured.family import Family
from stringcast.pipeline.studies.measured.pictures import picture
from stringcast.pipeline.studies.measured.scores import SETS, predicted, scored

WHERE = "conf/experiment/measured_study.yaml"


@dataclass(frozen=True)
class MeasuredSettings:
    """processes: 0 is one for each core. strings: names of those asked for, all if
    there are none.
    """

    processes: Annotated[int, Field(ge=0)]
    strings: list[str]
    families: dict[str, Family]


@dataclass(frozen=True)
class OneFit(StudyJob):
    """A set of effects and the string that it is fitted to. config: settings of the
    study, folder: its own.
    """

    family: str
    string: str
    laws: str
    config: Mapping[str, Any]
    folder: Path

    @property
    def name(self) -> str:
        return f"{self.string}-{self.laws.replace(' ', '_')}"

    def __call__(self) -> dict[str, Any]:
        """Fit, in this process alone; the row."""
        place = place_of(self.folder, self.string, self.laws)
        whole = not (place / "iterations").exists()
        dataset = self.folder / "datasets" / self.string
        here = prepare_experiment(
            settings(self, dataset), lambda block: f"conf/{block}"
        )
        result = perform_run(here, place, Terminal(quiet=True))
        block = self.config["measured"]["families"][self.family]
        family = build_dataclass(
            Family, block, f"measured.families.{self.family}", WHERE
        )
        names = {
            "string": self.string,
            "laws": self.laws,
            "effects": ", ".join(family.sets[self.laws]["effects"]),
        }
        row = (
            names
            | scored(here, result)
            | {"authors_tip": family.authors.get(self.string)}
        )
        used = os.times()
        commit = code_state()["commit"]
        return row | {
            "cpu": used.user + used.system if whole else None,
            "code": commit[:7] + commit[40:],
        }


def place_of(folder: Path, string: str, laws: str) -> Path:
    """The run of a fit. folder: the study's."""
    return folder / "fits" / f"{string}-{laws.replace(' ', '_')}"


@dataclass(frozen=True)
class MeasuredStudy(Study):
    """Strings that others measured, fitted with stated sets of effects."""

    KIND = "measured_study"
    TABLES: ClassVar = {"sets": SETS}
    BLOCK, MORE = "measured", ("strings", "processes")
    LIVES = 1  # so that a row tells the time of its own fit

    def check(self, experiment: Experiment) -> None:
        require_trials(experiment)

    def jobs(self, experiment: Experiment, folder: Path) -> list[OneFit]:
        """All sets of all strings that are asked for, whose datasets are then there."""
        config = experiment.config
        asked = build_dataclass(MeasuredSettings, config[self.BLOCK], self.BLOCK, WHERE)
        source = Path(config["trials"])
        there = {
            name: family.strings(source) for name, family in asked.families.items()
        }
        known = [string for strings in there.values() for string in strings]
        if unknown := set(asked.strings) - set(known):
            raise UserError(
                f"measured.strings: there is no {', '.join(sorted(unknown))}; there are {', '.join(known)}."
            )
        made = step_origin(
            {"measured": config["measured"], "trials": config["trials"]},
            "dataset",
            0,
            {},
        )
        fits = []
        for name, family in asked.families.items():
            for string in (
                string
                for string in there[name]
                if not asked.strings or string in asked.strings
            ):
                family.write(
                    source,
                    string,
                    there[name][string],
                    folder / "datasets" / string,
                    made,
                )
                fits += [
                    OneFit(name, string, laws, config, folder) for laws in family.sets
                ]
        return fits

    def tables(
        self, experiment: Experiment, made: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        names = [column.name for column in SETS.columns]
        return {
            "sets": SETS.check(pd.DataFrame([row for _, row in made], columns=names))
        }

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        sets = tables["sets"]
        fits = zip(sets["string"], sets["laws"], strict=True)
        picture(
            sets,
            {fit: predicted(place_of(folder, *fit)) for fit in fits},
            folder / "sets.png",
        )

    def sentence(self, tables: Mapping[str, pd.DataFrame]) -> str:
        sets = tables["sets"]
        best = sets.loc[sets.groupby("string", sort=False)["tip"].idxmin()]
        near, foretold = (
            f"{1e3 * off.min():.1f} to {1e3 * off.max():.1f}" if len(off) else "no"
            for off in (best["tip"], best["held_out_tip"].dropna())
        )
        return (
            f"{len(sets)} sets of effects on {len(best)} strings; of each string the nearest has the tip {near} mm off "
            f"in sample, {foretold} mm in trials held out."
        )


def settings(job: OneFit, dataset: Path) -> dict[str, Any]:
    """Settings of the run that the command line would begin: +experiment=estimate
    trials=<dataset> and the family's own.
    """
    family = job.config["measured"]["families"][job.family]
    own = (
        compose_settings(["+experiment=estimate"])
        | family["settings"]
        | family["sets"][job.laws]
    )
    own |= {"seed": job.config["seed"], "keep": [], "trials": str(dataset)}
    return inherit_settings(OmegaConf.create(own), {"string"})
