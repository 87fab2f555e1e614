"""What the stages hand to one another: frozen artifacts, each a handful of tables.

Every table's columns carry unit and meaning. Everything is SI and planar: x right,
y up, angles counter-clockwise from +x. `store` writes and reads artifacts; nothing
here touches a disk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from data.schema import Column, Table

JOINTS = ("q1", "q2", "q3")
SPEEDS = ("w1", "w2", "w3")

_TIME = Column("t", "s", "time; 0 is the start of the movement")
_Q = tuple(Column(f"q{j}", "rad", f"angle of joint {j}") for j in (1, 2, 3))
_W = tuple(Column(f"w{j}", "rad/s", f"commanded velocity of joint {j}") for j in (1, 2, 3))
_TRIAL = Column("trial", "", "name of the trial", "text")

# --- motion -----------------------------------------------------------------------------
COMMANDS = Table("commands", "joint commands on the arm's tick (5 ms)", (_TIME, *_Q, *_W))
CONTROL_POINTS = Table(
    "control_points",
    "Bezier control points V_0..V_5 of each joint's velocity curve (III)",
    (
        Column("joint", "1", "joint number, 1 is at the base", "int"),
        Column("index", "1", "n of V_n", "int"),
        _TIME,
        Column("velocity", "rad/s", "V_n"),
    ),
)
PREDICTED_STRING = Table(
    "string",
    "the string as simulated when the motion was chosen",
    (
        _TIME,
        Column("s", "m", "rest arc length from the grasp"),
        Column("x", "m", "position of the mass point"),
        Column("y", "m", "position of the mass point"),
    ),
)
ATTEMPTS = Table(
    "attempts",
    "what became of the motions that were tried",
    (
        Column("outcome", "", "why a motion was rejected, or 'hit'", "text"),
        Column("count", "1", "how many motions", "int"),
    ),
)
MOTION_OUTCOME = Table(
    "outcome",
    "one row: the motion that was chosen",
    (
        Column("duration", "s", "movement time T"),
        Column("t_hit", "s", "when the simulated tip is nearest to the target's centre inside the box"),
        Column("tip_x", "m", "simulated tip at t_hit"),
        Column("tip_y", "m", "simulated tip at t_hit"),
        Column("tried", "1", "motions tried", "int"),
        Column("target_x", "m", "centre of the target box"),
        Column("target_y", "m", "centre of the target box"),
        Column("target_w", "m", "full width of the target box"),
        Column("target_h", "m", "full height of the target box"),
    ),
)


@dataclass(frozen=True)
class Motion:
    """A planned movement: what `generate` makes and `execute` performs."""

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
        """Movement time T [s]."""
        return float(self.outcome["duration"].iloc[0])


# --- trial ------------------------------------------------------------------------------
ARM = Table("arm", "measured joint angles, on the arm's clock", (_TIME, *_Q))
TICKS = Table(
    "ticks",
    "the link, tick by tick",
    (
        Column("tick", "1", "number of the command", "int"),
        Column("t_due", "s", "when the command was due, host clock"),
        Column("t_sent", "s", "when it was written to the link, host clock"),
        Column("t_acknowledged", "s", "when its acknowledgement came, host clock; NaN if none"),
        Column("t_device", "s", "device clock in the acknowledgement; NaN if none"),
        *_W,
        *(Column(f"q{j}", "rad", f"measured angle of joint {j} in the acknowledgement") for j in (1, 2, 3)),
        Column("missed", "", "the command was late or lost", "bool"),
    ),
)
FRAMES = Table(
    "frames",
    "camera frames",
    (
        Column("frame", "1", "number of the frame", "int"),
        Column("t", "s", "middle of the exposure, camera clock; 0 is the start of the movement"),
        Column("file", "", "path of the image relative to the folder", "text"),
    ),
)
LINK = Table(
    "link",
    "one row: how the execution went",
    (
        Column("valid", "", "the trial is within its timing budget", "bool"),
        Column("reason", "", "why it is not; empty if it is", "text"),
        Column("ticks", "1", "commands sent", "int"),
        Column("missed", "1", "commands late or lost", "int"),
        Column("jitter_p50", "s", "median lateness of a command"),
        Column("jitter_p99", "s", "99th percentile of lateness"),
        Column("jitter_max", "s", "largest lateness"),
    ),
)


@dataclass(frozen=True)
class Trial:
    """One execution: what `execute` brings back from the arm and the camera.

    `images` is a sequence of grey uint8 arrays (height, width), in the
    order of `frames`; from disk it is read image by image.
    """

    arm: pd.DataFrame
    ticks: pd.DataFrame
    frames: pd.DataFrame
    link: pd.DataFrame
    images: Sequence[np.ndarray] = field(repr=False)

    TABLES: ClassVar[dict[str, Table]] = {"arm": ARM, "ticks": TICKS, "frames": FRAMES, "link": LINK}

    @property
    def film(self) -> Film:
        """What the camera saw, and where the arm was."""
        return Film(self.frames["t"].to_numpy(), self.images, arm=self.arm)


@dataclass(frozen=True)
class Film:
    """What a camera saw of one trial, ours or anybody's, and where the hand was.

    t: (F,) times of the frames [s]. images: F uint8 arrays (height, width). Exactly one of
    `arm` (joint angles, table ARM) and `grasp` (poses, table GRASP) is given.
    """

    t: np.ndarray
    images: Sequence[np.ndarray] = field(repr=False)
    arm: pd.DataFrame | None = None
    grasp: pd.DataFrame | None = None


# --- points -----------------------------------------------------------------------------
POINTS = Table(
    "points",
    "measured points of the string",
    (
        _TIME,
        Column("s", "m", "arc length from the grasp"),
        Column("x", "m", "measured position"),
        Column("y", "m", "measured position"),
        Column("sigma", "m", "one standard deviation of the position, across the string", optional=True),
        Column("valid", "", "the point can be used", "bool", optional=True),
    ),
)
READINGS = Table(
    "readings",
    "what was read in each frame",
    (
        Column("frame", "1", "number of the frame", "int"),
        _TIME,
        Column("valid", "", "the frame could be read", "bool"),
        Column("reason", "", "why it could not; empty if it could", "text"),
        Column("tip_x", "m", "tip of the string; NaN if not read"),
        Column("tip_y", "m", "tip of the string; NaN if not read"),
        Column("tip_sigma", "m", "one standard deviation of the tip"),
        Column("length", "m", "length of the centre-line that was read"),
    ),
)
MASKS = Table(
    "masks",
    "binarised string of each valid frame",
    (
        Column("frame", "1", "number of the frame", "int"),
        _TIME,
        Column("png", "", "1-bit PNG, camera pixels", "bytes"),
    ),
)


@dataclass(frozen=True)
class Points:
    """The string seen in each frame: what `extract` makes of a trial's images."""

    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {"points": POINTS, "readings": READINGS, "masks": MASKS}


# --- observation ------------------------------------------------------------------------
GRASP = Table(
    "grasp",
    "pose of the grasp",
    (
        _TIME,
        Column("x", "m", "position of the grasp"),
        Column("y", "m", "position of the grasp"),
        Column("theta", "rad", "direction in which the string leaves the grasp"),
    ),
)


@dataclass(frozen=True)
class Observation:
    """One trial as estimation and diagnosis see it, ours or anybody's.

    Exactly one of `arm` (joint angles, table ARM) and `grasp` (poses, table GRASP) is given.
    `masks` is empty where only points were measured, `points` where they are yet to be read
    from frames. moving: the string is not at rest when the trial begins.
    """

    trial: str
    points: pd.DataFrame
    readings: pd.DataFrame
    masks: pd.DataFrame
    arm: pd.DataFrame | None = None
    grasp: pd.DataFrame | None = None
    moving: bool = False


# --- estimate ---------------------------------------------------------------------------
PARAMETERS = Table(
    "parameters",
    "the estimated parameters",
    (
        Column("name", "", "parameter", "text"),
        Column("symbol", "", "its symbol in the paper; empty if it has none", "text"),
        Column("unit", "", "its unit", "text"),
        Column("meaning", "", "what it is", "text"),
        Column("value", "", "best value, in `unit`"),
        Column("low", "", "lower end of the 95 % interval, in `unit`; NaN if the method gives none"),
        Column("high", "", "upper end of the 95 % interval, in `unit`; NaN if the method gives none"),
        Column("minimum", "", "lower end of the search range, in `unit`"),
        Column("maximum", "", "upper end of the search range, in `unit`"),
        Column("chi", "1", "exponent of the best value within its range, Eq. 3"),
        Column("at_bound", "", "the value sits at an end of its range", "bool"),
        Column("determined", "", "this data determines it", "bool"),
    ),
)
CANDIDATES = Table(
    "candidates",
    "every candidate tried; beside these columns one for each parameter, named after it",
    (
        Column("candidate", "1", "number of the candidate, in the order tried", "int"),
        Column("matching_rate", "1", "E, Eq. 5; NaN if the run was rejected"),
        Column("finite", "", "the run stayed finite", "bool"),
        Column("accepted", "", "it was the best so far", "bool"),
    ),
)
MATCHING = Table(
    "matching",
    "the matching rate frame by frame, before and after estimation",
    (
        _TRIAL,
        _TIME,
        Column("before", "1", "E_f with the parameters before this estimation"),
        Column("after", "1", "E_f with the estimated parameters"),
    ),
)
FIT = Table(
    "fit",
    "one row: how the estimation went",
    (
        Column("method", "", "how the parameters were estimated", "text"),
        Column("before", "1", "E before"),
        Column("after", "1", "E after"),
        Column("rms_before", "m", "centre-line residual before, root mean square"),
        Column("rms_after", "m", "centre-line residual after, root mean square"),
        Column("rejected", "1", "candidates rejected because they did not stay finite", "int"),
        Column("sentence", "", "what this data can and cannot determine, in words", "text"),
    ),
)


@dataclass(frozen=True)
class Estimate:
    """String parameters found from trials: what `estimate` makes."""

    parameters: pd.DataFrame
    candidates: pd.DataFrame
    matching: pd.DataFrame
    fit: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {
        "parameters": PARAMETERS,
        "candidates": CANDIDATES,
        "matching": MATCHING,
        "fit": FIT,
    }

    def tables(self) -> dict[str, Table]:
        """TABLES, with the columns that `candidates` has for the parameters."""
        rows = self.parameters[["name", "unit", "meaning"]].itertuples(index=False)
        own = tuple(Column(name, unit, meaning) for name, unit, meaning in rows)
        return self.TABLES | {"candidates": replace(CANDIDATES, columns=(*CANDIDATES.columns, *own))}

    def values(self) -> dict[str, float]:
        """Best value of each parameter, by name."""
        return dict(zip(self.parameters["name"], self.parameters["value"], strict=True))
