"""Artifacts of casts and trials: motions, recordings and points.

An artifact is the output of a stage: a frozen dataclass of a few tables. Its field
`TABLES` maps their names to schemas. Other artifacts are in `estimates`,
`explanations`, `diagnoses`, `alignment` and `calibration`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pandas as pd

from stringcast.data.schema import Table, parse_columns, tables_by_name

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
        obstacle, arrival or arm
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
    """A planned movement: made by `generate`, performed by `execute`."""

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
        """Whether the motion was planned for a target, from control points."""
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
    """The record of one execution by arm and camera, made by `execute`.

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
    by_share (bool, optional): s is the share of the measured line's length at this
        point, times the string's length; else the point is a mark on the string
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
    """The string in each frame, read from images by `extract`."""

    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame

    TABLES: ClassVar = tables_by_name(POINTS, READINGS, MASKS)

    @property
    def valid_points(self) -> pd.DataFrame:
        """The valid points; all of them if the table does not state it."""
        return valid_rows(self.points)


def valid_rows(points: pd.DataFrame) -> pd.DataFrame:
    """Select the valid points, and those of which the table does not state it."""
    if "valid" not in points:
        return points
    return points[points["valid"].fillna(True).astype(bool)]


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
        Measured points; empty until they are extracted from frames.
    readings
        Results of the extraction for each frame.
    masks
        The binarised string of each frame; empty if only points were measured.
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
        return valid_rows(self.points)


@dataclass(frozen=True)
class TrialSet:
    """Trials that are used together.

    Attributes
    ----------
    observations
        The trials.
    films
        Frames of the filmed trials, by name.
    rejected
        Reasons why other trials cannot be used, by name.
    held_out
        Names of the trials that are used only to measure the gain.
    iteration_numbers
        Iterations of the run that recorded the trials.
    """

    observations: Sequence[Observation]
    films: Mapping[str, Film] = field(default_factory=dict)
    rejected: Mapping[str, str] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    iteration_numbers: tuple[int, ...] = ()
