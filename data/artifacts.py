"""The artifacts that stages exchange: frozen dataclasses of a few tables each.

The field `TABLES` of each maps its tables' names to their schemas.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from stringcast.data.schema import Column, Table

JOINTS = ("q1", "q2", "q3")
SPEEDS = ("w1", "w2", "w3")
SENT_SPEEDS = ("sent1", "sent2", "sent3")

TIME_COLUMN = Column("t", "s", "time; 0 is the start of the movement")
ANGLE_COLUMNS = tuple(Column(f"q{j}", "rad", f"angle of joint {j}") for j in (1, 2, 3))
SPEED_COLUMNS = tuple(
    Column(f"w{j}", "rad/s", f"commanded velocity of joint {j}") for j in (1, 2, 3)
)
TRIAL_COLUMN = Column("trial", "", "name of the trial", "text")
_FRAME = Column("frame", "1", "number of the frame", "int")
_S = Column("s", "m", "arc length from the grasp")
_MEASURED_POINT = (
    TIME_COLUMN,
    _S,
    Column("x", "m", "measured position"),
    Column("y", "m", "measured position"),
)

# --- motion
# -----------------------------------------------------------------------------
COMMANDS = Table(
    "commands",
    "joint commands on the arm's tick (5 ms)",
    (TIME_COLUMN, *ANGLE_COLUMNS, *SPEED_COLUMNS),
)
CONTROL_POINTS = Table(
    "control_points",
    "Bezier control points V_0..V_5 of each joint's velocity curve (III)",
    (
        Column("joint", "1", "joint number, 1 is at the base", "int"),
        Column("index", "1", "n of V_n", "int"),
        TIME_COLUMN,
        Column("velocity", "rad/s", "V_n"),
    ),
)
PREDICTED_STRING = Table(
    "string",
    "the string as simulated when the motion was chosen",
    (
        TIME_COLUMN,
        Column("s", "m", "rest arc length from the grasp"),
        Column("x", "m", "position of the mass point"),
        Column("y", "m", "position of the mass point"),
    ),
)
ATTEMPTS = Table(
    "attempts",
    "outcomes of the motions that were tried",
    (
        Column("outcome", "", "why a motion was rejected, or 'hit'", "text"),
        Column("count", "1", "how many motions", "int"),
    ),
)
MOTION_OUTCOME = Table(
    "outcome",
    "one row: the chosen motion; NaN if there is no target",
    (
        Column("duration", "s", "movement time T"),
        Column(
            "t_hit",
            "s",
            "when the simulated tip is nearest to the target's centre inside the box",
        ),
        Column("tip_x", "m", "simulated tip at t_hit"),
        Column("tip_y", "m", "simulated tip at t_hit"),
        Column("tried", "1", "motions tried", "int"),
        Column("target_x", "m", "centre of the target box"),
        Column("target_y", "m", "centre of the target box"),
        Column("target_w", "m", "full width of the target box"),
        Column("target_h", "m", "full height of the target box"),
        Column(
            "chance",
            "1",
            "predicted probability of a hit, where it was computed",
            optional=True,
        ),
        Column("chance_low", "1", "lower end of its 95 % interval", optional=True),
        Column("chance_high", "1", "upper end", optional=True),
    ),
)


@dataclass(frozen=True)
class Motion:
    """A planned movement, which `generate` makes and `execute` performs."""

    commands: pd.DataFrame
    control_points: pd.DataFrame
    string: pd.DataFrame
    attempts: pd.DataFrame
    outcome: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {
        "commands": COMMANDS,
        "control_points": CONTROL_POINTS,
        "string": PREDICTED_STRING,
        "attempts": ATTEMPTS,
        "outcome": MOTION_OUTCOME,
    }

    @property
    def duration(self) -> float:
        """The movement time T [s]."""
        return float(self.outcome["duration"].iloc[0])


# --- trial
# ------------------------------------------------------------------------------
ARM = Table(
    "arm", "measured joint angles, on the arm's clock", (TIME_COLUMN, *ANGLE_COLUMNS)
)
TICKS = Table(
    "ticks",
    "the link, tick by tick",
    (
        Column("tick", "1", "number of the command", "int"),
        Column("t_due", "s", "when the command was due, host clock"),
        Column("t_sent", "s", "when it was written to the link, host clock"),
        Column(
            "t_acknowledged",
            "s",
            "when its acknowledgement came, host clock; NaN if none",
        ),
        Column("t_device", "s", "device clock in the acknowledgement; NaN if none"),
        *SPEED_COLUMNS,
        *(
            Column(
                f"q{j}", "rad", f"measured angle of joint {j} in the acknowledgement"
            )
            for j in (1, 2, 3)
        ),
        Column("missed", "", "the command was late or lost", "bool"),
        *(
            Column(
                f"sent{j}",
                "rad/s",
                f"velocity of joint {j} as the link carried it",
                optional=True,
            )
            for j in (1, 2, 3)
        ),
    ),
)
FRAMES = Table(
    "frames",
    "frames of the camera",
    (
        _FRAME,
        Column(
            "t",
            "s",
            "middle of the exposure, camera clock; 0 is the start of the movement",
        ),
        Column("file", "", "path of the image relative to the folder", "text"),
        Column(
            "number",
            "1",
            "number on the camera's schedule: skipped ones were dropped",
            "int",
            optional=True,
        ),
        Column("late", "s", "lateness against the schedule", optional=True),
        Column(
            "repeats",
            "1",
            "repetitions by the camera, which were left out",
            "int",
            optional=True,
        ),
    ),
)
LINK = Table(
    "link",
    "one row: how the execution went",
    (
        Column("valid", "", "arm and camera are within their budgets", "bool"),
        Column("reason", "", "why it is not; empty if it is", "text"),
        Column("ticks", "1", "commands sent", "int"),
        Column("missed", "1", "commands late or lost", "int"),
        Column("jitter_p50", "s", "median lateness of a command"),
        Column("jitter_p99", "s", "99th percentile of lateness"),
        Column("jitter_max", "s", "largest lateness"),
        Column("trip_p50", "s", "median round trip of the link test", optional=True),
        Column("trip_p99", "s", "99th percentile of the round trips", optional=True),
        Column("trip_max", "s", "longest round trip", optional=True),
        Column(
            "frames_due",
            "1",
            "frames on the camera's schedule until the end",
            "int",
            optional=True,
        ),
        Column(
            "frames_dropped",
            "1",
            "missing frames of the schedule",
            "int",
            optional=True,
        ),
        Column(
            "frames_repeated",
            "1",
            "frames repeated instead of new ones",
            "int",
            optional=True,
        ),
        Column(
            "frames_late", "1", "frames later than half a period", "int", optional=True
        ),
        Column("fps", "1/s", "rate of the schedule", optional=True),
        Column("frame_jitter_p50", "s", "median lateness of a frame", optional=True),
        Column("frame_jitter_p99", "s", "99th percentile of lateness", optional=True),
        Column("frame_jitter_max", "s", "largest lateness", optional=True),
        Column("remarks", "", "unverified facts of the camera", "text", optional=True),
    ),
)


@dataclass(frozen=True)
class Trial:
    """The record of one execution by arm and camera, which `execute` makes.

    `images` is a sequence of grey uint8 arrays (height, width), in the order of
    `frames`; from disk they are read one by one.
    """

    arm: pd.DataFrame
    ticks: pd.DataFrame
    frames: pd.DataFrame
    link: pd.DataFrame
    images: Sequence[np.ndarray] = field(repr=False)

    TABLES: ClassVar[dict[str, Table]] = {
        "arm": ARM,
        "ticks": TICKS,
        "frames": FRAMES,
        "link": LINK,
    }

    @property
    def film(self) -> Film:
        """The frames and the joint angles of the trial."""
        return Film(self.frames["t"].to_numpy(), self.images, arm=self.arm)


@dataclass(frozen=True)
class Film:
    """The frames of one trial and the motion of the hand.

    Attributes
    ----------
    t : (F,)
        Times of the frames [s].
    images
        F uint8 arrays (height, width).
    arm, grasp
        Joint angles (table ARM) or poses (table GRASP); exactly one is given.
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    arm: pd.DataFrame | None = None
    grasp: pd.DataFrame | None = None


# --- points
# -----------------------------------------------------------------------------
POINTS = Table(
    "points",
    "measured points of the string",
    (
        *_MEASURED_POINT,
        Column("sigma", "m", "one standard deviation of a coordinate", optional=True),
        Column("valid", "", "the point can be used", "bool", optional=True),
    ),
)
READINGS = Table(
    "readings",
    "readings of each frame",
    (
        _FRAME,
        TIME_COLUMN,
        Column("valid", "", "the frame could be read", "bool"),
        Column("reason", "", "why it could not; empty if it could", "text"),
        Column("tip_x", "m", "tip of the string; NaN if not read"),
        Column("tip_y", "m", "tip of the string; NaN if not read"),
        Column("tip_sigma", "m", "one standard deviation of a coordinate of the tip"),
        Column("length", "m", "length of the centre-line that was read"),
    ),
)
MASKS = Table(
    "masks",
    "binarised string of each valid frame",
    (
        _FRAME,
        TIME_COLUMN,
        Column("png", "", "1-bit PNG, camera pixels", "bytes"),
    ),
)


@dataclass(frozen=True)
class Points:
    """The string in each frame, which `extract` reads from a trial's images."""

    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {
        "points": POINTS,
        "readings": READINGS,
        "masks": MASKS,
    }

    @property
    def valid_points(self) -> pd.DataFrame:
        """The valid points; all of them if the table does not state it."""
        return _valid_rows(self.points)


def _valid_rows(points: pd.DataFrame) -> pd.DataFrame:
    return points[points["valid"].astype(bool)] if "valid" in points else points


# --- observation
# ------------------------------------------------------------------------
GRASP = Table(
    "grasp",
    "pose of the grasp",
    (
        TIME_COLUMN,
        Column("x", "m", "position of the grasp"),
        Column("y", "m", "position of the grasp"),
        Column("theta", "rad", "direction in which the string leaves the grasp"),
    ),
)


@dataclass(frozen=True)
class Observation:
    """The measurements of one trial that estimation and diagnosis use.

    Attributes
    ----------
    trial
        Its name.
    points
        Measured points; empty where they are yet to be read from frames.
    readings
        What was read in each frame.
    masks
        The binarised string of each frame; empty where only points were measured.
    arm, grasp
        Joint angles (table ARM) or poses (table GRASP); exactly one is given.
    starts_moving
        Whether the string moves when the trial begins.
    """

    trial: str
    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame
    arm: pd.DataFrame | None = None
    grasp: pd.DataFrame | None = None
    starts_moving: bool = False

    @property
    def valid_points(self) -> pd.DataFrame:
        """The valid points; all of them if the table does not state it."""
        return _valid_rows(self.points)


@dataclass(frozen=True)
class TrialSet:
    """Trials that are used together.

    Attributes
    ----------
    observations
        The trials.
    films
        Frames of those that were filmed, by name.
    rejected
        Reasons why other trials cannot be used, by name of the trial.
    held_out
        Names of the trials that only measure a gain.
    iteration_numbers
        Iterations of a run in which they were recorded.
    """

    observations: Sequence[Observation]
    films: Mapping[str, Film] = field(default_factory=dict)
    rejected: Mapping[str, str] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    iteration_numbers: tuple[int, ...] = ()


# --- estimate
# ---------------------------------------------------------------------------
PARAMETERS = Table(
    "parameters",
    "the estimated parameters",
    (
        Column("name", "", "parameter", "text"),
        Column("symbol", "", "its symbol in the paper; empty if it has none", "text"),
        Column("unit", "", "its unit", "text"),
        Column("meaning", "", "what it is", "text"),
        Column("value", "", "best value, in `unit`"),
        Column(
            "low",
            "",
            "lower end of the 95 % interval, in `unit`; NaN if the method gives none",
        ),
        Column(
            "high",
            "",
            "upper end of the 95 % interval, in `unit`; NaN if the method gives none",
        ),
        Column("minimum", "", "lower end of the search range, in `unit`"),
        Column("maximum", "", "upper end of the search range, in `unit`"),
        Column("chi", "1", "exponent of the best value within its range, Eq. 3"),
        Column("at_bound", "", "the value sits at an end of its range", "bool"),
        Column("determined", "", "the data determine it", "bool"),
    ),
)
CANDIDATES = Table(
    "candidates",
    "all candidates that were tried; one more column for each parameter",
    (
        Column("candidate", "1", "number of the candidate, in the order tried", "int"),
        Column("matching_rate", "1", "E, Eq. 5; NaN if the run was rejected"),
        Column("finite", "", "the run stayed finite", "bool"),
        Column("accepted", "", "it was the best so far", "bool"),
    ),
)
DRAWS = Table(
    "draws",
    "equally likely strings given the trials; one more column for each parameter",
    (Column("draw", "1", "number of the draw", "int"),),
)
MATCHING = Table(
    "matching",
    "the matching rate frame by frame, before and after estimation",
    (
        TRIAL_COLUMN,
        TIME_COLUMN,
        Column("before", "1", "E_f with the parameters before this estimation"),
        Column("after", "1", "E_f with the estimated parameters"),
    ),
)
ESTIMATION_SUMMARY = Table(
    "fit",
    "one row: how the estimation went",
    (
        Column("method", "", "how the parameters were estimated", "text"),
        Column("before", "1", "E before"),
        Column("after", "1", "E after"),
        Column("rms_before", "m", "centre-line residual before, root mean square"),
        Column("rms_after", "m", "centre-line residual after, root mean square"),
        Column("tip_before", "m", "the same of the measured point nearest the tip"),
        Column("tip_after", "m", "the same of the measured point nearest the tip"),
        Column(
            "rejected",
            "1",
            "candidates rejected because they did not stay finite",
            "int",
        ),
        Column("sentence", "", "what the data determine, in words", "text"),
    ),
)


@dataclass(frozen=True)
class Estimate:
    """Parameters of the string, which `estimate` fits to trials."""

    parameters: pd.DataFrame
    candidates: pd.DataFrame
    matching: pd.DataFrame
    fit: pd.DataFrame
    draws: pd.DataFrame = field(default_factory=DRAWS.empty)

    TABLES: ClassVar[dict[str, Table]] = {
        "parameters": PARAMETERS,
        "candidates": CANDIDATES,
        "matching": MATCHING,
        "fit": ESTIMATION_SUMMARY,
        "draws": DRAWS,
    }

    def tables(self) -> dict[str, Table]:
        """Return TABLES with columns of the parameters in `candidates` and `draws`."""
        candidates, draws = list(CANDIDATES.columns), list(DRAWS.columns)
        rows = self.parameters[["name", "unit", "meaning"]]
        for name, unit, meaning in rows.itertuples(index=False):
            candidates.append(Column(name, unit, meaning))
            draws.append(Column(name, unit, meaning, optional=True))
        return self.TABLES | {
            "candidates": replace(CANDIDATES, columns=tuple(candidates)),
            "draws": replace(DRAWS, columns=tuple(draws)),
        }

    def values(self) -> dict[str, float]:
        """Return the best value of each parameter, by name."""
        return dict(zip(self.parameters["name"], self.parameters["value"], strict=True))


PREDICTED = Table(
    "predicted",
    "every measured point of a trial that nothing was fitted to, and its prediction",
    (
        TRIAL_COLUMN,
        *_MEASURED_POINT,
        Column("predicted_x", "m", "position in the model"),
        Column("predicted_y", "m", "position in the model"),
    ),
)
SCORE = Table(
    "score",
    "one row: the error in a trial that nothing was fitted to",
    (
        TRIAL_COLUMN,
        Column(
            "free",
            "1",
            "parameters of this trial alone: of its initial state or rest position",
            "int",
        ),
        Column("rms", "m", "centre-line residual, root mean square"),
        Column("tip", "m", "the same of the measured point nearest the tip"),
    ),
)


@dataclass(frozen=True)
class Prediction:
    """The prediction of a trial that nothing was fitted to, which `predict` makes."""

    predicted: pd.DataFrame
    score: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {"predicted": PREDICTED, "score": SCORE}


# --- diagnosis
# --------------------------------------------------------------------------
RESIDUALS = Table(
    "residuals",
    "every used measured point, and its position in the base and the extended model",
    (
        TRIAL_COLUMN,
        *_MEASURED_POINT,
        Column("sigma", "m", "noise floor of a coordinate"),
        Column("doubt", "m", "noise and numerical error together"),
        Column("base_x", "m", "the base model fitted to the trials that were used"),
        Column("base_y", "m", "the base model fitted to the trials that were used"),
        Column(
            "extended_x", "m", "the extended model fitted to the trials that were used"
        ),
        Column(
            "extended_y", "m", "the extended model fitted to the trials that were used"
        ),
        Column(
            "base_normal",
            "m",
            "measured less base model, across the string, to its left",
        ),
        Column(
            "base_tangential",
            "m",
            "measured less base model, along the string, towards the tip",
        ),
    ),
)
HYPOTHESES = Table(
    "hypotheses",
    "every set of causes that was fitted",
    (
        Column(
            "causes",
            "",
            "active effects, joined by ' + '; empty for the base model",
            "text",
        ),
        Column("parameters", "1", "parameters fitted", "int"),
        Column(
            "mean_square",
            "1",
            "of the residual over noise and numerical error; 1 or less is noise",
        ),
        Column("fit_gain", "1", "log evidence over the base model"),
        Column(
            "held_out_gain",
            "1",
            "the same without the trial that gains most; NaN if not evaluated",
        ),
        Column(
            "moved",
            "m",
            "tip displacement by these causes, root mean square, largest trial",
        ),
        Column(
            "unexplained",
            "1",
            "unexplained share of the base model's mean-square tip residual",
        ),
        Column("probability", "1", "of the last cause against its alternatives"),
    ),
)
ENTRIES = Table(
    "entries",
    "what each cause explains given those added before: by trial, time and arc length",
    (
        Column("number", "1", "of the cause in the order of addition, from 1", "int"),
        Column("cause", "", "name", "text"),
        Column("evidence", "1", "log evidence of the cause given those before it"),
        TRIAL_COLUMN,
        Column("log_likelihood", "1", "increase of the trial's log-likelihood"),
        TIME_COLUMN,
        _S,
        Column("before", "m", "residual without the cause, root mean square"),
        Column("after", "m", "the same with it"),
    ),
)
SCREENING = Table(
    "screening",
    "what each effect would explain to first order",
    (
        Column("context", "", "active causes, joined by ' + '", "text"),
        Column("effect", "", "name", "text"),
        Column("predicted_gain", "1", "of the log-likelihood"),
    ),
)
LIKENESS = Table(
    "likeness",
    "similarity of two effects in this data, after the fitted parameters are projected out",
    (
        Column("effect", "", "name", "text"),
        Column("other", "", "name", "text"),
        Column("cosine", "1", "between their displacements: 1 is indistinguishable"),
    ),
)
CAUSES = Table(
    "causes",
    "the reported causes, one row for each of their parameters",
    (
        Column("effect", "", "name", "text"),
        Column("probability", "1", "of the cause"),
        Column("sentence", "", "the cause in words", "text"),
        Column("parameter", "", "qualified name; empty if it has none", "text"),
        Column("meaning", "", "what it is", "text"),
        Column("unit", "", "its unit", "text"),
        Column("value", "", "best value, in `unit`"),
        Column("low", "", "lower end of the 95 % interval, in `unit`"),
        Column(
            "high",
            "",
            "upper end, in `unit`; of the range, where only the lower one is known",
        ),
        Column("at_least", "1", "only the lower end of the interval is known", "bool"),
    ),
)
HELD_OUT = Table(
    "held_out",
    "base and extended model on each trial, fitted without it",
    (
        TRIAL_COLUMN,
        Column("rms_base", "m", "centre-line residual"),
        Column("rms_extended", "m", "centre-line residual"),
        Column("noise_floor", "m", "residual of noise alone"),
        Column("tip_rms_base", "m", "residual at the largest arc length measured"),
        Column("tip_rms_extended", "m", "residual at the largest arc length measured"),
        Column("E_base", "1", "matching rate, Eq. 5"),
        Column("E_extended", "1", "matching rate, Eq. 5"),
        Column("log_likelihood_difference", "1", "extended less base"),
        Column(
            "rms_known", "m", "of the extended model fitted to all trials of the search"
        ),
    ),
)
MISSING = Table(
    "missing",
    "residual of the extended model beyond noise, where it exceeds the tolerance",
    (
        TRIAL_COLUMN,
        TIME_COLUMN,
        _S,
        Column("x", "m", "along x"),
        Column("y", "m", "along y"),
    ),
)
PREDICTED_STRINGS = Table(
    "predicted",
    "the string on the proposed motion by each hypothesis, fitted to the likeliest one",
    (
        Column(
            "hypothesis",
            "",
            "its causes, joined by ' + '; the likeliest comes first",
            "text",
        ),
        TIME_COLUMN,
        _S,
        Column("x", "m", "position"),
        Column("y", "m", "position"),
        Column(
            "sigma",
            "m",
            "noise and numerical error of all points that this one represents",
        ),
    ),
)
DIAGNOSIS_SUMMARY = Table(
    "finding",
    "one row: the verdict",
    (
        Column(
            "verdict", "", "none, effect, ambiguous, unknown or insufficient", "text"
        ),
        Column("sentence", "", "in words", "text"),
        Column("diagnosis", "", "diagnosis.json", "text"),
        Column("extended", "", "the extended model as settings, YAML", "text"),
    ),
)


@dataclass(frozen=True)
class Diagnosis:
    """The causes of the discrepancy between simulation and trials, and their evidence.

    `diagnose` makes it.
    """

    finding: pd.DataFrame
    causes: pd.DataFrame
    held_out: pd.DataFrame
    residuals: pd.DataFrame
    hypotheses: pd.DataFrame
    entries: pd.DataFrame
    screening: pd.DataFrame
    likeness: pd.DataFrame
    missing: pd.DataFrame
    commands: pd.DataFrame
    control_points: pd.DataFrame
    predicted: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {
        "finding": DIAGNOSIS_SUMMARY,
        "causes": CAUSES,
        "held_out": HELD_OUT,
        "residuals": RESIDUALS,
        "hypotheses": HYPOTHESES,
        "entries": ENTRIES,
        "screening": SCREENING,
        "likeness": LIKENESS,
        "missing": MISSING,
        "commands": COMMANDS,
        "control_points": CONTROL_POINTS,
        "predicted": PREDICTED_STRINGS,
    }

    @property
    def verdict(self) -> str:
        """The verdict: none, effect, ambiguous, unknown or insufficient."""
        return str(self.finding["verdict"].iloc[0])

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return str(self.finding["sentence"].iloc[0])

    @property
    def was_interrupted(self) -> bool:
        """Whether the search was ended before all candidates were compared."""
        return bool(json.loads(self.finding["diagnosis"].iloc[0]).get("interrupted"))

    @property
    def motion(self) -> Motion | None:
        """The motion that would distinguish look-alikes, ready to be performed.

        It is None if no motion is proposed.
        """
        if self.commands.empty:
            return None
        hypothesis = self.predicted["hypothesis"]
        likeliest = self.predicted[hypothesis == hypothesis.iloc[0]]
        outcome = {column.name: [np.nan] for column in MOTION_OUTCOME.columns}
        outcome["duration"] = [self.commands["t"].max()]
        outcome["tried"] = [0]
        return Motion(
            self.commands,
            self.control_points,
            PREDICTED_STRING.check(likeliest[["t", "s", "x", "y"]]),
            ATTEMPTS.empty(),
            MOTION_OUTCOME.check(pd.DataFrame(outcome)),
        )
