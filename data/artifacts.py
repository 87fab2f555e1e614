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

from stringcast.data.schema import Column, Table, parse_columns, tables_by_name

JOINTS = ("q1", "q2", "q3")
SPEEDS = ("w1", "w2", "w3")
SENT_SPEEDS = ("sent1", "sent2", "sent3")

# --- motion
COMMANDS = Table(
    "commands",
    "joint commands on the arm's tick (5 ms)",
    parse_columns("""
    t [s]: time; 0 is the start of the movement
    q1 [rad]: angle of joint 1
    q2 [rad]: angle of joint 2
    q3 [rad]: angle of joint 3
    w1 [rad/s]: commanded velocity of joint 1
    w2 [rad/s]: commanded velocity of joint 2
    w3 [rad/s]: commanded velocity of joint 3
    """),
)
CONTROL_POINTS = Table(
    "control_points",
    "Bezier control points V_0..V_5 of each joint's velocity curve (III)",
    parse_columns("""
    joint [1] (int): joint number, 1 is at the base
    index [1] (int): n of V_n
    t [s]: time; 0 is the start of the movement
    velocity [rad/s]: V_n
    """),
)
PREDICTED_STRING = Table(
    "string",
    "the string as simulated when the motion was chosen",
    parse_columns("""
    t [s]: time; 0 is the start of the movement
    s [m]: rest arc length from the grasp
    x [m]: position of the mass point
    y [m]: position of the mass point
    """),
)
ATTEMPTS = Table(
    "attempts",
    "outcomes of the motions that were tried",
    parse_columns("""
    outcome (text): why a motion was rejected, or 'hit'
    count [1] (int): how many motions
    """),
)
MOTION_OUTCOME = Table(
    "outcome",
    "one row: the chosen motion; NaN if there is no target",
    parse_columns("""
    duration [s]: movement time T
    t_hit [s]: when the simulated tip is nearest to the target's centre inside the box
    tip_x [m]: simulated tip at t_hit
    tip_y [m]: simulated tip at t_hit
    tried [1] (int): motions tried
    target_x [m]: centre of the target box
    target_y [m]: centre of the target box
    target_w [m]: full width of the target box
    target_h [m]: full height of the target box
    chance [1] (optional): predicted probability of a hit, where it was computed
    chance_low [1] (optional): lower end of its 95 % interval
    chance_high [1] (optional): upper end
    likeness [1] (optional): correlation of the tip's error with that of the last
        cast at t_hit, where there was a last cast
    correction [m] (optional): distance by which that error moves the tip at t_hit
    limit (text, optional): what makes a hit unlikely, where it is: uncertainty,
        obstacle or arm
    likely_x [m] (optional): centre of the nearest box that a motion is likely to hit
    likely_y [m] (optional): the same
    likely_chance [1] (optional): predicted probability of this hit
    tip_sd [m] (optional): uncertainty of the tip at the target after this cast
    taught_sd [m] (optional): the same after the most informative motion that was tried
    prospects (text, optional): these in sentences; empty where a hit is likely
    """),
)


def outcome_without_target(duration: float, tried: int) -> pd.DataFrame:
    """Return table MOTION_OUTCOME of a motion without a target."""
    names = [column.name for column in MOTION_OUTCOME.columns]
    row = {"duration": duration, "tried": tried, "limit": "", "prospects": ""}
    return MOTION_OUTCOME.check(pd.DataFrame([row], columns=names))


@dataclass(frozen=True)
class Motion:
    """A planned movement, which `generate` makes and `execute` performs."""

    commands: pd.DataFrame
    control_points: pd.DataFrame
    string: pd.DataFrame
    attempts: pd.DataFrame
    outcome: pd.DataFrame

    TABLES: ClassVar = tables_by_name(
        COMMANDS,
        CONTROL_POINTS,
        PREDICTED_STRING,
        ATTEMPTS,
        MOTION_OUTCOME,
    )

    @property
    def duration(self) -> float:
        """The movement time T [s]."""
        return float(self.outcome["duration"].iloc[0])

    @property
    def is_cast(self) -> bool:
        """Whether it throws the tip at a target, along curves with control points."""
        return not self.control_points.empty


# --- trial
ARM = Table(
    "arm",
    "measured joint angles, on the arm's clock",
    parse_columns("""
    t [s]: time; 0 is the start of the movement
    q1 [rad]: angle of joint 1
    q2 [rad]: angle of joint 2
    q3 [rad]: angle of joint 3
    """),
)
TICKS = Table(
    "ticks",
    "the link, tick by tick",
    parse_columns("""
    tick [1] (int): number of the command
    t_due [s]: when the command was due, host clock
    t_sent [s]: when it was written to the link, host clock
    t_acknowledged [s]: when its acknowledgement came, host clock; NaN if none
    t_device [s]: device clock in the acknowledgement; NaN if none
    w1 [rad/s]: commanded velocity of joint 1
    w2 [rad/s]: commanded velocity of joint 2
    w3 [rad/s]: commanded velocity of joint 3
    q1 [rad]: measured angle of joint 1 in the acknowledgement
    q2 [rad]: measured angle of joint 2 in the acknowledgement
    q3 [rad]: measured angle of joint 3 in the acknowledgement
    missed (bool): the command was late or lost
    sent1 [rad/s] (optional): velocity of joint 1 as the link carried it
    sent2 [rad/s] (optional): velocity of joint 2 as the link carried it
    sent3 [rad/s] (optional): velocity of joint 3 as the link carried it
    """),
)
FRAMES = Table(
    "frames",
    "frames of the camera",
    parse_columns("""
    frame [1] (int): number of the frame
    t [s]: middle of the exposure, camera clock; 0 is the start of the movement
    file (text): path of the image relative to the folder
    sha256 (text, optional): digest of the image file, also of one that was not kept
    number [1] (int, optional): number on the camera's schedule: skipped ones were
        dropped
    late [s] (optional): lateness against the schedule
    repeats [1] (int, optional): repetitions by the camera, which were left out
    """),
)
LINK = Table(
    "link",
    "one row: how the execution went",
    parse_columns("""
    valid (bool): arm and camera are within their budgets
    reason (text): why it is not; empty if it is
    ticks [1] (int): commands sent
    missed [1] (int): commands late or lost
    jitter_p50 [s]: median lateness of a command
    jitter_p99 [s]: 99th percentile of lateness
    jitter_max [s]: largest lateness
    trip_p50 [s] (optional): median round trip of the link test
    trip_p99 [s] (optional): 99th percentile of the round trips
    trip_max [s] (optional): longest round trip
    frames_due [1] (int, optional): frames on the camera's schedule until the end
    frames_dropped [1] (int, optional): missing frames of the schedule
    frames_repeated [1] (int, optional): frames repeated instead of new ones
    frames_late [1] (int, optional): frames later than half a period
    fps [1/s] (optional): rate of the schedule
    frame_jitter_p50 [s] (optional): median lateness of a frame
    frame_jitter_p99 [s] (optional): 99th percentile of lateness
    frame_jitter_max [s] (optional): largest lateness
    remarks (text, optional): unverified facts of the camera
    """),
)


def lateness_columns(name: str, times: np.ndarray) -> dict[str, float]:
    """Return median, 99th percentile and largest of times [s], as columns of LINK."""
    p50, p99, largest = map(float, np.percentile(times, [50, 99, 100]))
    return {f"{name}_p50": p50, f"{name}_p99": p99, f"{name}_max": largest}


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

    TABLES: ClassVar = tables_by_name(
        ARM,
        TICKS,
        FRAMES,
        LINK,
    )

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
POINTS = Table(
    "points",
    "measured points of the string",
    parse_columns("""
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: measured position
    y [m]: measured position
    sigma [m] (optional): one standard deviation of a coordinate
    valid (bool, optional): the point can be used
    """),
)
READINGS = Table(
    "readings",
    "readings of each frame",
    parse_columns("""
    frame [1] (int): number of the frame
    t [s]: time; 0 is the start of the movement
    valid (bool): the frame could be read
    reason (text): why it could not; empty if it could
    tip_x [m]: tip of the string; NaN if not read
    tip_y [m]: tip of the string; NaN if not read
    tip_sigma [m]: one standard deviation of a coordinate of the tip
    length [m]: length of the centre-line that was read
    hand_shift [m] (optional): distance of the hand from where its joints put it
    joint_error [rad] (optional): largest error of a joint, as the arm is seen
    """),
)
MASKS = Table(
    "masks",
    "binarised string of each valid frame",
    parse_columns("""
    frame [1] (int): number of the frame
    t [s]: time; 0 is the start of the movement
    png (bytes): 1-bit PNG, camera pixels
    """),
)


@dataclass(frozen=True)
class Points:
    """The string in each frame, which `extract` reads from a trial's images."""

    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame

    TABLES: ClassVar = tables_by_name(POINTS, READINGS, MASKS)

    @property
    def valid_points(self) -> pd.DataFrame:
        """The valid points; all of them if the table does not state it."""
        return _valid_rows(self.points)


def _valid_rows(points: pd.DataFrame) -> pd.DataFrame:
    return points[points["valid"].astype(bool)] if "valid" in points else points


# --- observation
GRASP = Table(
    "grasp",
    "pose of the grasp",
    parse_columns("""
    t [s]: time; 0 is the start of the movement
    x [m]: position of the grasp
    y [m]: position of the grasp
    theta [rad]: direction in which the string leaves the grasp
    """),
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
PARAMETERS = Table(
    "parameters",
    "the estimated parameters",
    parse_columns("""
    name (text): parameter
    symbol (text): its symbol in the paper; empty if it has none
    unit (text): its unit
    meaning (text): what it is
    value: best value, in `unit`
    low: lower end of the 95 % interval, in `unit`; NaN if the method gives none
    high: upper end of the 95 % interval, in `unit`; NaN if the method gives none
    minimum: lower end of the search range, in `unit`
    maximum: upper end of the search range, in `unit`
    chi [1]: exponent of the best value within its range, Eq. 3
    at_bound (bool): the value sits at an end of its range
    determined (bool): the data determine it
    """),
)
CANDIDATES = Table(
    "candidates",
    "all candidates that were tried; one more column for each parameter",
    parse_columns("""
    candidate [1] (int): number of the candidate, in the order tried
    matching_rate [1]: E, Eq. 5; NaN if the run was rejected
    finite (bool): the run stayed finite
    accepted (bool): it was the best so far
    """),
)
DRAWS = Table(
    "draws",
    "equally likely strings given the trials; one more column for each parameter",
    parse_columns("""
    draw [1] (int): number of the draw
    """),
)
MISFIT = Table(
    "misfit",
    "how far the estimate leaves the tip off in the last trial",
    parse_columns("""
    t [s]: time of the frame; 0 is the start of the movement
    x [m]: measured less simulated position of the measured point nearest the tip
    y [m]: measured less simulated position of the measured point nearest the tip
    hand_x [m]: position of the hand
    hand_y [m]: position of the hand
    """),
)
MATCHING = Table(
    "matching",
    "the matching rate frame by frame, before and after estimation",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    before [1]: E_f with the parameters before this estimation
    after [1]: E_f with the estimated parameters
    """),
)
ESTIMATION_SUMMARY = Table(
    "fit",
    "one row: how the estimation went",
    parse_columns("""
    method (text): how the parameters were estimated
    before [1]: E before
    after [1]: E after
    rms_before [m]: centre-line residual before, root mean square
    rms_after [m]: centre-line residual after, root mean square
    tip_before [m]: the same of the measured point nearest the tip
    tip_after [m]: the same of the measured point nearest the tip
    rejected [1] (int): candidates rejected because they did not stay finite
    sentence (text): what the data determine, in words
    """),
)


@dataclass(frozen=True)
class Estimate:
    """Parameters of the string, which `estimate` fits to trials."""

    parameters: pd.DataFrame
    candidates: pd.DataFrame
    matching: pd.DataFrame
    fit: pd.DataFrame
    draws: pd.DataFrame = field(default_factory=DRAWS.empty)
    misfit: pd.DataFrame = field(default_factory=MISFIT.empty)

    TABLES: ClassVar = tables_by_name(
        PARAMETERS,
        CANDIDATES,
        MATCHING,
        ESTIMATION_SUMMARY,
        DRAWS,
        MISFIT,
    )

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

    @property
    def model_error_m(self) -> float:
        """Error of the model on motions unlike those of the trials [m]."""
        return float(self.fit["rms_after"].iloc[0])


# --- surprise and its explanation
SURPRISE_SUMMARY = Table(
    "surprise",
    "one row: whether the trial is within what was predicted",
    parse_columns("""
    draws [1] (int): predictions that the trial is compared with
    frames [1] (int): frames in which the tip is compared
    distance [1]: of the tip from the predictions, over their spread; NaN without any
    p_value [1]: share of predictions that lie as far from the others; NaN without any
    surprising (bool): the trial is not within what was predicted
    sentence (text): the same in words
    """),
)


@dataclass(frozen=True)
class Surprise:
    """Test of whether a trial is within what was predicted."""

    surprise: pd.DataFrame

    TABLES: ClassVar = tables_by_name(SURPRISE_SUMMARY)

    @property
    def is_surprising(self) -> bool:
        """Whether the trial is not within what was predicted."""
        return bool(self.surprise["surprising"].iloc[0])

    @property
    def p_value(self) -> float:
        """Predictive p-value of the trial; NaN without predictions."""
        return float(self.surprise["p_value"].iloc[0])

    @property
    def sentence(self) -> str:
        """The result in words."""
        return str(self.surprise["sentence"].iloc[0])


MIN_SHOWN_PROBABILITY = 0.01  # of a cause, in run.json and on pages
# verdicts whose causes leave much of the misfit unexplained
PARTLY_EXPLAINED = ("partial", "undecided", "unknown")
EXPLANATIONS = Table(
    "explanations",
    "causes that were compared, the most probable first; none has an empty name",
    parse_columns("""
    effects (text): names, separated by spaces; empty for the model as it was
    probability [1]: that these alone are active, among those compared
    log_evidence [1]: gain over the model as it was
    tip_rms [m]: distance of the simulated from the measured tip, root mean square
    fitted (bool): fitted from many starts; else compared on a coarse mesh
    """),
)
EXPLANATION_SUMMARY = Table(
    "finding",
    "one row: the cause of a surprising trial",
    parse_columns("""
    verdict (text): not asked, none, cause, candidates, partial, unknown or undecided
    candidates [1] (int): causes that could act in these trials
    fitted [1] (int): causes that were fitted
    sentence (text): the verdict in words
    rms_without [m] (optional): centre-line residual of the model without causes
    """),
)


@dataclass(frozen=True)
class Explanation(Estimate):
    """An estimate with the causes that explain surprising trials.

    Its draws are those of all probable causes, as often as each is probable.
    """

    explanations: pd.DataFrame = field(default_factory=EXPLANATIONS.empty)
    finding: pd.DataFrame = field(default_factory=EXPLANATION_SUMMARY.empty)

    TABLES: ClassVar = {
        **Estimate.TABLES,
        **tables_by_name(EXPLANATIONS, EXPLANATION_SUMMARY),
    }

    @property
    def verdict(self) -> str:
        """The verdict in a word or two."""
        return str(self.finding["verdict"].iloc[0])

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return str(self.finding["sentence"].iloc[0])

    @property
    def model_error_m(self) -> float:
        """Error of the model on motions unlike those of the trials [m].

        Causes that leave much unexplained may stand in for another cause, and then fit
        these trials alone. The error is then that of the model without them.
        """
        left_m = super().model_error_m
        if self.verdict not in PARTLY_EXPLAINED:
            return left_m
        return max(left_m, float(self.finding["rms_without"].iloc[0]))

    @property
    def named_causes(self) -> tuple[str, ...]:
        """Names of the effects that explain the trials; empty without a verdict."""
        return next(iter(self.cause_sets)) if self.verdict == "cause" else ()

    @property
    def causes(self) -> dict[str, float]:
        """Probability of each effect that was compared, alone or with others."""
        causes: dict[str, float] = {}
        for names, probability in self.cause_sets.items():
            for name in names:
                causes[name] = causes.get(name, 0.0) + probability
        return causes

    @property
    def cause_sets(self) -> dict[tuple[str, ...], float]:
        """Probability of all effects that were compared together, by their names."""
        table = self.explanations
        pairs = zip(table["effects"], table["probability"], strict=True)
        return {tuple(str(names).split()): float(p) for names, p in pairs}


PREDICTED = Table(
    "predicted",
    "every measured point of a trial that nothing was fitted to, and its prediction",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: measured position
    y [m]: measured position
    predicted_x [m]: position in the model
    predicted_y [m]: position in the model
    """),
)
SCORE = Table(
    "score",
    "one row: the error in a trial that nothing was fitted to",
    parse_columns("""
    trial (text): name of the trial
    free [1] (int): parameters of this trial alone: of its initial state or rest
        position
    rms [m]: centre-line residual, root mean square
    tip [m]: the same of the measured point nearest the tip
    """),
)


@dataclass(frozen=True)
class Prediction:
    """The prediction of a trial that nothing was fitted to, which `predict` makes."""

    predicted: pd.DataFrame
    score: pd.DataFrame

    TABLES: ClassVar = tables_by_name(PREDICTED, SCORE)


# --- diagnosis
RESIDUALS = Table(
    "residuals",
    "every used measured point, and its position in the base and the extended model",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: measured position
    y [m]: measured position
    sigma [m]: noise floor of a coordinate
    doubt [m]: noise and numerical error together
    base_x [m]: the base model fitted to the trials that were used
    base_y [m]: the base model fitted to the trials that were used
    extended_x [m]: the extended model fitted to the trials that were used
    extended_y [m]: the extended model fitted to the trials that were used
    base_normal [m]: measured less base model, across the string, to its left
    base_tangential [m]: measured less base model, along the string, towards the tip
    """),
)
HYPOTHESES = Table(
    "hypotheses",
    "every set of causes that was fitted",
    parse_columns("""
    causes (text): active effects, joined by ' + '; empty for the base model
    parameters [1] (int): parameters fitted
    mean_square [1]: of the residual over noise and numerical error; 1 or less is noise
    fit_gain [1]: log evidence over the base model
    held_out_gain [1]: the same without the trial that gains most; NaN if not evaluated
    moved [m]: tip displacement by these causes, root mean square, largest trial
    unexplained [1]: unexplained share of the base model's mean-square tip residual
    probability [1]: of the last cause against its alternatives; NaN if not among them
    """),
)
ENTRIES = Table(
    "entries",
    "what each cause explains given those added before: by trial, time and arc length",
    parse_columns("""
    number [1] (int): of the cause in the order of addition, from 1
    cause (text): name
    evidence [1]: log evidence of the cause given those before it
    trial (text): name of the trial
    log_likelihood [1]: increase of the trial's log-likelihood
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    before [m]: residual without the cause, root mean square
    after [m]: the same with it
    """),
)
SCREENING = Table(
    "screening",
    "what each effect would explain to first order",
    parse_columns("""
    context (text): active causes, joined by ' + '
    effect (text): name
    predicted_gain [1]: of the log-likelihood
    """),
)
LIKENESS = Table(
    "likeness",
    "similarity of two effects in this data, after the fitted parameters are "
    "projected out",
    parse_columns("""
    effect (text): name
    other (text): name
    cosine [1]: between their displacements: 1 is indistinguishable
    """),
)
CAUSES = Table(
    "causes",
    "the reported causes, one row for each of their parameters",
    parse_columns("""
    effect (text): name
    probability [1]: of the cause
    sentence (text): the cause in words
    parameter (text): qualified name; empty if it has none
    meaning (text): what it is
    unit (text): its unit
    value: best value, in `unit`
    low: lower end of the 95 % interval, in `unit`
    high: upper end, in `unit`; of the range, where only the lower one is known
    at_least [1] (bool): only the lower end of the interval is known
    """),
)
HELD_OUT = Table(
    "held_out",
    "base and extended model on each trial, fitted without it",
    parse_columns("""
    trial (text): name of the trial
    rms_base [m]: centre-line residual
    rms_extended [m]: centre-line residual
    noise_floor [m]: residual of noise alone
    tip_rms_base [m]: residual at the largest arc length measured
    tip_rms_extended [m]: residual at the largest arc length measured
    E_base [1]: matching rate, Eq. 5
    E_extended [1]: matching rate, Eq. 5
    log_likelihood_difference [1]: extended less base
    rms_known [m]: of the extended model fitted to all trials of the search
    """),
)
MISSING = Table(
    "missing",
    "residual of the extended model beyond noise, where it exceeds the tolerance",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: along x
    y [m]: along y
    """),
)
PREDICTED_STRINGS = Table(
    "predicted",
    "the string on the proposed motion by each hypothesis, fitted to the likeliest one",
    parse_columns("""
    hypothesis (text): its causes, joined by ' + '; the likeliest comes first
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: position
    y [m]: position
    sigma [m]: noise and numerical error of all points that this one represents
    """),
)
DIAGNOSIS_SUMMARY = Table(
    "finding",
    "one row: the verdict",
    parse_columns("""
    verdict (text): none, effect, ambiguous, partial, unknown or insufficient
    sentence (text): in words
    diagnosis (text): diagnosis.json
    extended (text): the extended model as settings, YAML
    """),
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

    TABLES: ClassVar = tables_by_name(
        DIAGNOSIS_SUMMARY,
        CAUSES,
        HELD_OUT,
        RESIDUALS,
        HYPOTHESES,
        ENTRIES,
        SCREENING,
        LIKENESS,
        MISSING,
        COMMANDS,
        CONTROL_POINTS,
        PREDICTED_STRINGS,
    )

    @property
    def verdict(self) -> str:
        """The verdict: none, effect, ambiguous, partial, unknown or insufficient."""
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
        return Motion(
            self.commands,
            self.control_points,
            PREDICTED_STRING.check(likeliest[["t", "s", "x", "y"]]),
            ATTEMPTS.empty(),
            outcome_without_target(self.commands["t"].max(), 0),
        )
