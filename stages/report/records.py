"""Records of the data that pages show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure

from stringcast.data.artifacts import JOINTS, Motion, Observation, Points, Trial
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Explanation, Surprise
from stringcast.stages.hit_test import HitResult, tip_path
from stringcast.stages.inference.prepared_trial import observed_motion
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.model import Model
from stringcast.stages.model.target import Target
from stringcast.stages.report.outcomes import CAST_OUTCOMES, Outcome, parameter_outcome


# --- a stage of any kind
@dataclass(frozen=True)
class StageRecord:
    """Content of the page of a stage, with its artifact.

    settings: nested blocks. provenance: seed, code, packages. next_commands: purposes
    and command lines.
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
class CastRecord:
    """A cast and its simulation.

    before, after: strings (F, n, 2) [m] at the frame times with the parameters before
    and after estimation; NaN where the simulation diverged.
    """

    motion: Motion
    trial: Trial
    points: Points
    estimate: Estimate | None
    verdict: HitResult
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)
    surprise: Surprise | None = None

    @property
    def explanation(self) -> Explanation | None:
        """The estimate with its causes, if a search was made."""
        if isinstance(self.estimate, Explanation):
            return self.estimate
        return None

    @cached_property
    def frame_times(self) -> np.ndarray:
        """Times of the frames [s], shape (F,)."""
        return self.trial.frames["t"].to_numpy()

    @property
    def is_valid(self) -> bool:
        """Whether the trial is valid; a dry run is not."""
        return bool(self.trial.link["valid"].iloc[0])

    @property
    def closest_frame(self) -> int:
        """Frame of the closest approach, or the middle one if no tip was read."""
        if np.isfinite(self.verdict.t):
            return self.frame_at(self.verdict.t)
        return len(self.frame_times) // 2

    def frame_at(self, t: float) -> int:
        """Return the frame nearest to a time [s]."""
        return int(np.argmin(np.abs(self.frame_times - t)))

    @cached_property
    def grey_range(self) -> tuple[float, float]:
        """Grey levels of black and white: the extremes of the closest frame.

        Percentiles would not do, because a thin string covers too few pixels.
        """
        image = self.trial.images[self.closest_frame]
        return float(image.min()), float(max(image.max(), image.min() + 1))

    @cached_property
    def centre_lines(self) -> dict[int, np.ndarray]:
        """Measured centre-lines by frame: (K, 3) of x, y and arc length [m]."""
        frames = self.points.valid_points.groupby("t", sort=True)[["x", "y", "s"]]
        return {self.frame_at(t): rows.to_numpy() for t, rows in frames}

    def centre_line(self, frame: int) -> np.ndarray:
        """Return the centre-line of a frame [m], (K, 2); empty if it was not read."""
        return self.centre_lines.get(frame, np.zeros((0, 3)))[:, :2]

    def tip_path(self, t: np.ndarray) -> np.ndarray:
        """Return the tip (K, 2) [m] at times (K,) [s].

        It is a cubic through its readings, as in the hit test, and NaN outside them.
        """
        readings = self.points.readings
        read_times = readings.loc[readings["valid"].astype(bool), "t"]
        is_inside = (t >= read_times.min()) & (t <= read_times.max())
        return np.where(is_inside[:, None], tip_path(readings, t), np.nan)

    def joint_positions(self, arm: Arm) -> np.ndarray:
        """Return measured positions of base, joints and hand [m], (K, J + 1, 2)."""
        return arm.joint_positions(self.trial.arm[list(JOINTS)].to_numpy())


@dataclass(frozen=True)
class RunRecord:
    """Content of the page of a run; no casts if it only estimated.

    estimates: all of the run, in order. look: the slow trial before the first cast; its
    verdict has no meaning. next_commands: as in `StageRecord`.
    """

    name: str
    sentence: str
    hit: bool
    model: Model
    target: Target
    obstacles: tuple[Box, ...]
    casts: tuple[CastRecord, ...]
    estimates: tuple[Estimate, ...]
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]
    next_commands: Sequence[tuple[str, str]] = ()
    look: CastRecord | None = None


def simulate_cast(
    model: Model,
    observation: Observation,
    trial: Trial,
    previous: Estimate | None,
    estimate: Estimate | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate strings (F, n, 2) [m] of a cast, before and after estimation.

    previous, estimate: estimates before and after the cast; by default, the start
    values and the estimate before.
    """
    values_before = {} if previous is None else previous.values()
    values_after = values_before if estimate is None else estimate.values()
    times = trial.frames["t"].to_numpy()
    motion = observed_motion(observation).extended_until(times.max(initial=0.0))
    simulated = []
    for values in (values_before, values_after):
        extended = extend_model(model, values)
        row = extended.values(values)[None]
        string = extended.simulate_observation(motion, row, times)
        simulated.append(string.points[0])
    before, after = simulated
    return before, after


# --- a diagnosis
MAX_DRAWN_TRIALS = 8


@dataclass(frozen=True)
class DiagnosisRecord:
    """Content of the page of a diagnosis, with the configured model."""

    diagnosis: Diagnosis
    model: Model

    @cached_property
    def document(self) -> dict[str, Any]:
        """Parsed content of the file diagnosis.json."""
        return self.diagnosis.document

    @cached_property
    def extension(self) -> dict[str, Any]:
        """Settings of the extended model."""
        return yaml.safe_load(self.diagnosis.finding["extended"].iloc[0]) or {}

    @cached_property
    def is_extended(self) -> bool:
        """Whether the extended model differs from the base model."""
        table = self.diagnosis.residuals
        base = table[["base_x", "base_y"]]
        extended = table[["extended_x", "extended_y"]]
        return not np.array_equal(base, extended)

    @property
    def added_effects(self) -> list[str]:
        """Names of the effects that were added to the configured model."""
        configured = {effect.name for effect in self.model.effects}
        return [name for name in self.extension["effects"] if name not in configured]

    @cached_property
    def models(self) -> tuple[str, ...]:
        """Names of the models to compare: base, and extended if it differs."""
        return ("base", "extended") if self.is_extended else ("base",)

    @property
    def has_excluded_trials(self) -> bool:
        """Whether the held-out trials were excluded from all fits and the search."""
        held_out = set(self.document["gain"]["held_out_trials"])
        return not held_out <= set(self.document["trials"]["used"])

    @cached_property
    def drawn_trials(self) -> dict[str, pd.DataFrame]:
        """Residuals of the trials with the largest misfit of the base model."""
        table = self.diagnosis.residuals
        misfit = trial_rms(table, "base").sort_values(ascending=False)
        drawn = list(misfit.index[:MAX_DRAWN_TRIALS])
        return {
            str(name): rows for name, rows in table.groupby("trial") if name in drawn
        }


def complex_residual(table: pd.DataFrame, model: str) -> np.ndarray:
    """Return measured minus simulated positions of table RESIDUALS, x + iy (n,) [m].

    model: base or extended.
    """
    x, y = table["x"] - table[f"{model}_x"], table["y"] - table[f"{model}_y"]
    return (x + 1j * y).to_numpy()


def model_distances(table: pd.DataFrame, model: str) -> np.ndarray:
    """Return distances (n,) [m] between measured points of table RESIDUALS and a model.

    model: base or extended.
    """
    return np.abs(complex_residual(table, model))


def trial_rms(table: pd.DataFrame, model: str) -> pd.Series:
    """Return the root mean square of a model's distances [m] in each trial."""
    squares = pd.Series(model_distances(table, model) ** 2)
    return np.sqrt(squares.groupby(table["trial"].to_numpy()).mean())


# --- a sweep
SEED_COLUMN = "seed"


@dataclass(frozen=True)
class SweepRecord:
    """Content of the page of a sweep.

    jobs: a row for each; see `pipeline.sweep.table`. setting_names: its columns that
    are settings. parameter_columns: units of its columns that are parameters. settings:
    those that all jobs share. units: of settings that have one.
    """

    name: str
    sentence: str
    jobs: pd.DataFrame = field(repr=False)
    setting_names: Sequence[str]
    parameter_columns: Mapping[str, str]
    settings: Mapping[str, Any] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    units: Mapping[str, str]

    @cached_property
    def finished_jobs(self) -> pd.DataFrame:
        """Jobs that ran to their end, each with a seed."""
        finished = self.jobs[self.jobs["state"] == "done"]
        if SEED_COLUMN in finished:
            return finished
        return finished.assign(**{SEED_COLUMN: 0})

    @cached_property
    def failed_jobs(self) -> pd.DataFrame:
        """Jobs that ended with an error."""
        return self.jobs[self.jobs["state"] == "failed"]

    @cached_property
    def varied_settings(self) -> list[str]:
        """Settings with several values, seeds included."""
        return [name for name in self.setting_names if self.jobs[name].nunique() > 1]

    @cached_property
    def factors(self) -> list[str]:
        """Varied settings except the seed."""
        return [name for name in self.varied_settings if name != SEED_COLUMN]

    @cached_property
    def outcomes(self) -> list[Outcome]:
        """Results with a value for at least one job."""
        parameters = [
            parameter_outcome(*item) for item in self.parameter_columns.items()
        ]
        candidates = [*CAST_OUTCOMES, *parameters]
        return [o for o in candidates if self.finished_jobs[o.name].notna().any()]

    @property
    def seed_count(self) -> int:
        """Number of seeds among the finished jobs."""
        return int(self.finished_jobs[SEED_COLUMN].nunique())


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
}  # in the order of the page; "nine" combines three strings and three targets


@dataclass(frozen=True)
class PaperFigure:
    """A figure, and a description for screen readers."""

    figure: Figure = field(repr=False)
    alt: str


@dataclass(frozen=True)
class PaperRecord:
    """Content of the page of the paper's experiments.

    tables: by name; see `pipeline.paper`. settings: those that all runs share.
    """

    tables: Mapping[str, pd.DataFrame] = field(repr=False)
    requested_runs: int
    settings: Mapping[str, Any] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)

    def rows_of(self, table: str, condition: str) -> pd.DataFrame:
        """Return the rows of one experiment in a table."""
        rows = self.tables[table]
        return rows[rows["condition"] == condition]

    def cast_rows(self, table: str, condition: str, number: int) -> pd.DataFrame:
        """Return the rows of a cast of the drawn run in a table."""
        rows = self.rows_of(table, condition)
        return rows[rows["cast"] == number]

    def cast_numbers(self, condition: str) -> list[int]:
        """Return the numbers of the drawn run's casts; empty without a finished run."""
        return sorted(self.rows_of("lines", condition)["cast"].unique().tolist())

    def cast_verdict(self, condition: str, number: int) -> pd.Series:
        """Return the row of table casts for a cast of the drawn run."""
        seed = self.rows_of("lines", condition)["seed"].iloc[0]
        rows = self.cast_rows("casts", condition, number)
        return rows[rows["seed"] == seed].iloc[0]

    @property
    def finished_experiments(self) -> list[str]:
        """Experiments with a finished run, in the order of the page."""
        finished = set(self.tables["rates"]["condition"])
        return [name for name in EXPERIMENT_LABELS if name in finished]
