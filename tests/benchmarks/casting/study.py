"""The casting studies.

Several methods cast strings of the virtual lab at targets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.model_settings import build_string
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.model.parameter import parameter_values
from tests.benchmarks.casting.pictures import draw_hits
from tests.benchmarks.casting.runs import run_casts
from tests.benchmarks.casting.scores import ALL_CASES, TABLES, score_casts
from tests.benchmarks.casting.worlds import World
from tests.benchmarks.study import Config, Study, StudyJob

DRAW_STREAM = 7  # tells the numbers that draw strings from others of the same seed
Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class TrainingCasts:
    """The training casts of a run.

    `casts` is their number, `generate` holds the settings of the stage that plans them,
    and `target` is their target.
    """

    casts: Annotated[int, Field(ge=0)]
    generate: dict[str, Any]
    target: dict[str, Any]


@dataclass(frozen=True)
class CastingSettings:
    """Settings of a casting study.

    `seeds` is the number of seeds from `first`, the same for all methods. `casts` is
    the largest number of casts in a run. `processes` is 0 for one per core. `noise` is
    the standard deviation of a measured coordinate [m]. `methods` and `cases` change
    settings. Each case is repeated with each set of effects in `hidden`, by name.
    Methods in `informed` know the hidden effects and their values. `draw_strings` has
    every seed draw its string from the ranges of the parameters. `simulator` names the
    reference simulator that moves the string; then `hidden` holds causes of `causes.py`
    with their settings. Without it the virtual lab does.
    """

    seeds: Count
    first: Annotated[int, Field(ge=0)]
    training: TrainingCasts
    casts: Count
    processes: Annotated[int, Field(ge=0)]
    noise: Annotated[float, Field(gt=0)]
    methods: dict[str, dict[str, Any]]
    cases: dict[str, dict[str, Any]]
    hidden: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    informed: list[str] = field(default_factory=list)
    draw_strings: bool = False
    simulator: str | None = None

    def cases_with_hidden(self) -> list[tuple[str, dict[str, Any], World | None]]:
        """Return name, changes of settings and world of each case with what is hidden.

        The world is None for the virtual lab.
        """
        cases: list[tuple[str, dict[str, Any], World | None]] = []
        for name, case in self.cases.items():
            if not self.hidden:
                cases.append((name, case, None))
            for hidden, causes in self.hidden.items():
                if self.simulator is not None:
                    world = World(self.simulator, causes)
                    cases.append((f"{name}-{hidden}", case, world))
                    continue
                specimen = {**case.get("specimen", {}), "hidden": causes}
                changed = {**case, "specimen": specimen}
                cases.append((f"{name}-{hidden}", changed, None))
        return cases


@dataclass(frozen=True)
class RunJob(StudyJob):
    """A case, a method and a seed.

    `change` holds the settings of the case, and `config` those of the study. `world`
    moves the string in place of the lab, unless it is None.
    """

    case: str
    method: str
    seed: int
    change: Mapping[str, Any]
    config: Mapping[str, Any]
    world: World | None = None

    @property
    def name(self) -> str:
        """Name of the result file."""
        return f"{self.case}-{self.method}-{self.seed:04d}"

    def __call__(self) -> list[dict[str, Any]]:
        """Return a row for each cast."""
        method = self.config["casting"]["methods"][self.method]
        rows = run_casts(self.config, self.change, method, self.seed, self.world)
        return [row | {"code": code_state()["commit"]} for row in rows]


def tell_hidden(case: Mapping[str, Any]) -> dict[str, Any]:
    """Add to the settings of a case that the model has its hidden effects."""
    hidden = case["specimen"]["hidden"]
    values = {}
    for effect, parameters in hidden.items():
        values |= {f"{effect}.{name}": value for name, value in parameters.items()}
    return {**case, "effects": list(hidden), "parameter_values": values}


def draw_string(config: Config, case: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Draw the string of a case: each exponent of its range is equally likely."""
    parameters = build_string(config["string"], "conf/string").parameters
    rng = np.random.default_rng([seed, DRAW_STREAM])
    exponents = rng.uniform(0, 1, len(parameters))
    drawn = {}
    for parameter, value in zip(
        parameters, parameter_values(parameters, exponents), strict=True
    ):
        drawn[parameter.name] = float(value)
    return {**case, "specimen": {**case.get("specimen", {}), "parameters": drawn}}


@dataclass(frozen=True)
class CastingStudy(Study):
    """Methods of casting, compared by how many casts they need."""

    TABLES = TABLES
    BLOCK, GROWING = "casting", ("seeds", "first", "processes")

    def jobs(self, config: Config, folder: Path) -> list[RunJob]:
        """Return the jobs: for each seed all cases, each with all methods."""
        settings = build_dataclass(
            CastingSettings,
            config[self.BLOCK],
            self.BLOCK,
            "tests/benchmarks/conf/study",
        )
        jobs = []
        for seed in range(settings.first, settings.first + settings.seeds):
            for name, case, world in settings.cases_with_hidden():
                drawn = (
                    draw_string(config, case, seed) if settings.draw_strings else case
                )
                for method in settings.methods:
                    change = (
                        tell_hidden(drawn) if method in settings.informed else drawn
                    )
                    jobs.append(RunJob(name, method, seed, change, config, world))
        return jobs

    def tables(
        self, config: Config, results: Sequence[tuple[Any, Any]]
    ) -> Mapping[str, pd.DataFrame]:
        """Return table CASTS and the tables counted from it."""
        rows = []
        for job, casts in results:
            rows += [
                {"case": job.case, "method": job.method, "seed": job.seed, **cast}
                for cast in casts
            ]
        return score_casts(pd.DataFrame(rows), config[self.BLOCK]["casts"])

    def draw(self, tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
        """Write hits.png."""
        draw_hits(tables, folder / "hits.png")

    def summary(self, tables: Mapping[str, pd.DataFrame]) -> str:
        """Return the shares of runs that have hit, by method."""
        rates = tables["rates"][tables["rates"]["case"] == ALL_CASES]
        parts = []
        for method, rows in rates.groupby("method", sort=False):
            shares = ", ".join(f"{100 * share:.0f} %" for share in rows["share"])
            parts.append(
                f"{method}: {shares} of {rows['count'].iloc[0]} runs within 1 to {len(rows)} casts"
            )
        commits = tables["casts"]["code"].nunique()
        warning = (
            f" The runs were made by {commits} versions of the code."
            if commits > 1
            else ""
        )
        return f"Hit: {'; '.join(parts)}.{warning}"
