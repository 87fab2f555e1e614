"""The data that pages are made from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure

from stringcast.data.artifacts import (
    JOINTS,
    Diagnosis,
    Estimate,
    Motion,
    Observation,
    Points,
    Trial,
)
from stringcast.stages.hit_test import HitResult, tip_path
from stringcast.stages.inference.prepared_trial import observed_motion
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model
from stringcast.stages.report.outcomes import OUTCOMES, Outcome, parameter


# --- a stage of any kind
@dataclass(frozen=True)
class StageRecord:
    """name: of the run. sentence: what came out. made: the stage's artifact. model: as
    configured. settings: by name. origin: seed, code, packages. following: what can be
    done next, and the command.
    """

    name: str
    sentence: str
    artifact: Any = field(repr=False)
    model: Model = field(repr=False)
    settings: Mapping[str, Any] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    next_commands: Sequence[tuple[str, str]] = ()


# --- casts
@dataclass(frozen=True)
class Cast:
    """One manipulation. before, after: (F, n, 2) strings simulated at the frame times
    [m] with the parameters before and after estimation; NaN where the simulation did
    not stay finite.
    """

    motion: Motion
    trial: Trial
    points: Points
    estimate: Estimate | None
    verdict: HitResult
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)

    @cached_property
    def t(self) -> np.ndarray:
        """(F,) times of the frames [s]."""
        return self.trial.frames["t"].to_numpy()

    @property
    def valid(self) -> bool:
        """Whether its trial can be trusted; that of a dry run cannot."""
        return bool(self.trial.link["valid"].iloc[0])

    @property
    def nearest(self) -> int:
        """The frame of the closest approach, the middle one where no tip was read."""
        return (
            self.frame(self.verdict.t)
            if np.isfinite(self.verdict.t)
            else len(self.t) // 2
        )

    def frame(self, t: float) -> int:
        """The frame nearest to a time [s]."""
        return int(np.argmin(np.abs(self.t - t)))

    @cached_property
    def levels(self) -> tuple[float, float]:
        """Black and white of the frames, the same for all: the extremes of the frame of
        the closest approach, for a thin string is a smaller part of a frame than any
        percentile.
        """
        image = self.trial.images[self.nearest]
        return float(image.min()), float(max(image.max(), image.min() + 1))

    @cached_property
    def measured(self) -> dict[int, np.ndarray]:
        """The centre-lines that were read, by frame: (K, 3) of x, y and arc length [m]."""
        times = self.points.valid_points.groupby("t", sort=True)[["x", "y", "s"]]
        return {self.frame(t): rows.to_numpy() for t, rows in times}

    def tip(self, t: np.ndarray) -> np.ndarray:
        """The tip's way as it is judged, a cubic through the readings. t: (K,) [s].
        Returns (K, 2) [m]; NaN outside the readings and in gaps that are too long to
        guess.
        """
        read = self.points.readings.loc[self.points.readings["valid"].astype(bool), "t"]
        inside = (t >= read.min()) & (t <= read.max())
        return np.where(inside[:, None], tip_path(self.points.readings, t), np.nan)

    def joints(self, arm: Arm) -> np.ndarray:
        """Base, joints and hand as measured, (K, J + 1, 2) [m]."""
        return arm.joint_positions(self.trial.arm[list(JOINTS)].to_numpy())


@dataclass(frozen=True)
class RunRecord:
    """A run. casts is empty where only estimation ran; estimates: all, in order.
    following: see `Facts`.
    """

    name: str
    sentence: str
    hit: bool
    model: Model
    target: Box
    obstacles: tuple[Box, ...]
    casts: tuple[Cast, ...]
    estimates: tuple[Estimate, ...]
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]
    next_commands: Sequence[tuple[str, str]] = ()


def simulate_cast(
    model: Model,
    observation: Observation,
    made: tuple[Motion, Trial, Points, Estimate | None],
    verdict: HitResult,
    previous: Estimate | None,
) -> Cast:
    """Simulate the performed motion with the parameters before and after its
    estimation.
    """
    motion, trial, points, estimate = made
    known = {} if previous is None else previous.values()
    values = np.stack(
        [
            model.values(known),
            model.values(known if estimate is None else estimate.values()),
        ]
    )
    frames = trial.frames["t"].to_numpy()
    strings = model.simulate_observation(
        observed_motion(observation).extended_until(frames.max(initial=0.0)),
        values,
        frames,
    ).points
    return Cast(motion, trial, points, estimate, verdict, strings[0], strings[1])


# --- a diagnosis
TRIALS = 8  # drawn at most: those that the base model gets most wrong


@dataclass(frozen=True)
class DiagnosisRecord:
    """A diagnosis. model: as configured. library: effects by name. settings, origin,
    following: see `Facts`.
    """

    name: str
    diagnosis: Diagnosis
    model: Model
    library: Mapping[str, type[Effect]]
    settings: Mapping[str, Any]
    origin: Mapping[str, Any]
    following: Sequence[tuple[str, str]] = ()

    @cached_property
    def document(self) -> dict[str, Any]:
        """diagnosis.json."""
        return dict(json.loads(self.diagnosis.finding["diagnosis"].iloc[0]))

    @cached_property
    def extension(self) -> dict[str, Any]:
        """The extended model as settings."""
        return yaml.safe_load(self.diagnosis.finding["extended"].iloc[0]) or {}

    @cached_property
    def models(self) -> tuple[str, ...]:
        """base and extended; base alone where nothing was added to it."""
        table = self.diagnosis.residuals
        same = np.array_equal(
            table[["base_x", "base_y"]], table[["extended_x", "extended_y"]]
        )
        return ("base",) if same else ("base", "extended")

    @cached_property
    def trials(self) -> dict[str, pd.DataFrame]:
        """Residuals of the trials drawn, by name and in order."""
        table = self.diagnosis.residuals
        worst = list(rms(table, "base").sort_values(ascending=False).index[:TRIALS])
        return {
            str(name): rows for name, rows in table.groupby("trial") if name in worst
        }


def away(table: pd.DataFrame, model: str) -> np.ndarray:
    """(n,) distances of measured points from where a model has them [m]. table:
    RESIDUALS.
    """
    return np.hypot(
        table["x"] - table[f"{model}_x"], table["y"] - table[f"{model}_y"]
    ).to_numpy()


def rms(table: pd.DataFrame, model: str) -> pd.Series:
    """Root mean square of the distances in each trial [m]. table: RESIDUALS."""
    return np.sqrt(
        pd.Series(away(table, model) ** 2).groupby(table["trial"].to_numpy()).mean()
    )


# --- a sweep
SEED = "seed"


@dataclass(frozen=True)
class SweepRecord:
    """table: a row a job, see `pipeline.sweep.table`. given: its columns that are
    settings. estimated: unit and meaning of its columns that are parameters, by name.
    settings: those that all jobs have in common. units: of settings that have one.
    """

    name: str
    sentence: str
    jobs: pd.DataFrame = field(repr=False)
    setting_names: Sequence[str]
    parameter_columns: Mapping[str, tuple[str, str]]
    settings: Mapping[str, Any] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    units: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def done(self) -> pd.DataFrame:
        """The jobs that ran to their end, each with a seed."""
        done = self.jobs[self.jobs["state"] == "done"]
        return done if SEED in done else done.assign(**{SEED: 0})

    @cached_property
    def failed(self) -> pd.DataFrame:
        """The jobs that failed."""
        return self.jobs[self.jobs["state"] == "failed"]

    @cached_property
    def factors(self) -> tuple[str, ...]:
        """The settings that were varied, but for the seed, whose values only repeat the
        experiment.
        """
        return tuple(
            name
            for name in self.setting_names
            if name != SEED and self.jobs[name].nunique() > 1
        )

    @cached_property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Results with a value for at least one job."""
        every = (
            *OUTCOMES,
            *(
                parameter(name, *words)
                for name, words in self.parameter_columns.items()
            ),
        )
        return tuple(
            outcome for outcome in every if self.done[outcome.name].notna().any()
        )

    @property
    def seeds(self) -> int:
        """The number of seeds among the jobs that ended."""
        return int(self.done[SEED].nunique())


# --- the paper's experiments
EXPERIMENT_LABELS = {
    "A_300_900": "A to (300, 900)",
    "A_400_700": "A to (400, 700)",
    "A_500_900": "A to (500, 900)",
    "B_300_900": "B to (300, 900)",
    "B_400_700": "B to (400, 700)",
    "B_500_900": "B to (500, 900)",
    "C_300_900": "C to (300, 900)",
    "C_400_700": "C to (400, 700)",
    "C_500_900": "C to (500, 900)",
    "nine": "all nine together",
    "A_900_500": "A to (900, 500)",
    "one_motion_A": "A, one first motion",
    "one_motion_B": "B, one first motion",
    "one_motion_C": "C, one first motion",
    "D_500_500": "D to (500, 500)",
    "wall": "A around the wall",
    # every experiment, in the order in which they are shown, and those of three strings
    # to three targets as one
}


@dataclass(frozen=True)
class PaperFigure:
    """A figure, and what it shows in words for those who cannot see it."""

    figure: Figure = field(repr=False)
    alt: str


@dataclass(frozen=True)
class PaperRecord:
    """tables: by name, see `pipeline.studies.paper`. asked: how many runs were asked
    for. settings: those that all runs have in common. origin: what made the page.
    """

    tables: Mapping[str, pd.DataFrame] = field(repr=False)
    requested_runs: int
    settings: Mapping[str, Any] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)

    def of(self, table: str, condition: str) -> pd.DataFrame:
        """The rows of a table that are of one experiment."""
        whole = self.tables[table]
        return whole[whole["condition"] == condition]

    def cast(self, table: str, condition: str, manipulation: int) -> pd.DataFrame:
        """The rows that are of one cast of the run that is shown."""
        mine = self.of(table, condition)
        return mine[mine["manipulation"] == manipulation]

    def casts(self, condition: str) -> list[int]:
        """Numbers of the casts of the run that is shown; none where no run is done."""
        return sorted(self.of("lines", condition)["manipulation"].unique().tolist())

    def verdict(self, condition: str, manipulation: int) -> pd.Series:
        """Row of table casts of one cast of the run that is shown."""
        seed = self.of("lines", condition)["seed"].iloc[0]
        mine = self.cast("casts", condition, manipulation)
        return mine[mine["seed"] == seed].iloc[0]

    @property
    def conditions(self) -> list[str]:
        """Experiments of which a run has ended, in their order."""
        return [
            name
            for name in EXPERIMENT_LABELS
            if name in set(self.tables["rates"]["condition"])
        ]
