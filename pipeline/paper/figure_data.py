"""Collect the data of the figures: a typical run of each experiment, all results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from stringcast.data.artifacts import ARM, JOINTS, Motion, Points
from stringcast.data.estimates import Estimate
from stringcast.data.file_checks import read_json
from stringcast.data.schema import Table, parse_columns
from stringcast.data.store import load, read_table
from stringcast.pipeline.paper.scores import median_with_interval
from stringcast.pipeline.run.file_names import artifact_tables
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.model.arm import Arm

MOMENTS = 5  # times of drawn strings, up to the closest approach
CAST_COLUMNS = parse_columns("""
    condition (text): experiment of paper.yaml
    seed [1] (int): seed of the run
    cast [1] (int): number of the cast
    """)
PLACE_COLUMNS = parse_columns("""
    t [s]: time; 0 is the start of the movement
    x [m]: position
    y [m]: position
    """)
LINES = Table(
    "lines",
    "strings and arm at some moments of the casts, up to the closest approach",
    CAST_COLUMNS
    + parse_columns("""
    moment [1] (int): from 0
    kind (text): arm, measured, or foretold: simulated when the motion was chosen
    """)
    + PLACE_COLUMNS,
)
HANDS = Table(
    "hands",
    "hand path in the casts, from the measured joint angles",
    CAST_COLUMNS + PLACE_COLUMNS,
)
MATCHING = Table(
    "matching",
    "matching rate E_f over time in the casts",
    CAST_COLUMNS
    + parse_columns("""
    t [s]: time; 0 is the start of the movement
    before [1]: with the parameters used for the motion
    after [1]: with those estimated from this cast
    """),
)
BOXES = Table(
    "boxes",
    "target and obstacles of the casts",
    parse_columns("""
    condition (text): experiment of paper.yaml
    kind (text): target or obstacle
    x [m]: centre
    y [m]: centre
    w [m]: full width
    h [m]: full height
    """),
)
PARAMETERS = Table(
    "parameters",
    "parameters of the last estimation of each run",
    CAST_COLUMNS
    + parse_columns("""
    symbol (text): as in the paper
    value: in `unit`
    unit (text): as in the paper
    minimum: of the searched range, in `unit`
    maximum: of the searched range, in `unit`
    determined (bool): by these data
    """),
)
CAST_TABLES = (LINES, HANDS, MATCHING, BOXES)


def choose_typical_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Choose a run for each experiment: the lowest seed with the median of casts.

    `runs` is table RUNS of `scores`; only finished runs count.
    """
    done = runs[runs["state"] == "done"].sort_values("seed")
    median = done.groupby("condition")["hit_at"].transform(
        lambda hit_at: median_with_interval(hit_at.to_numpy())["median"]
    )
    return done[done["hit_at"] == median].groupby("condition", sort=False).head(1)


def cast_tables(
    folder: Path, runs: pd.DataFrame, casts: pd.DataFrame
) -> dict[str, pd.DataFrame]:
    """Return CAST_TABLES of a study by name.

    runs: from `choose_typical_runs`. casts: table CASTS.
    """
    parts: dict[str, list[pd.DataFrame]] = {table.name: [] for table in CAST_TABLES}
    for run in runs.itertuples():
        settings = read_json(folder / run.folder / "config.json")
        boxes = [{"kind": "target", **settings["target"]}]
        for box in settings["obstacles"]["boxes"]:
            boxes.append({"kind": "obstacle", **box})
        parts[BOXES.name].append(pd.DataFrame(boxes).assign(condition=run.condition))

        arm = build_dataclass(Arm, settings["arm"], "arm", "config.json")
        is_of_run = (casts["condition"] == run.condition) & (casts["seed"] == run.seed)
        for row in casts[is_of_run].itertuples():
            number = row.cast
            path = folder / run.folder / "iterations" / f"{number:02d}"
            key = {"condition": run.condition, "seed": run.seed, "cast": number}
            for name, frame in read_cast(path, arm, row.t_closest).items():
                parts[name].append(frame.assign(**key))

    tables = {}
    for table in CAST_TABLES:
        frames = parts[table.name]
        tables[table.name] = table.check(pd.concat(frames)) if frames else table.empty()
    return tables


def parameter_table(folder: Path, runs: pd.DataFrame) -> pd.DataFrame:
    """Return table PARAMETERS of the runs of a study's folder."""
    frames = []
    for run in runs.itertuples():
        paths = artifact_tables(folder / run.folder, "estimate", "parameters")
        if paths:
            frame = read_table(Estimate.TABLES["parameters"], paths[-1])
            number = int(paths[-1].parts[-3])
            key = {"condition": run.condition, "seed": run.seed, "cast": number}
            frames.append(frame.assign(**key))
    if not frames:
        return PARAMETERS.empty()
    names = [column.name for column in PARAMETERS.columns]
    return PARAMETERS.check(pd.concat(frames)[names])


def read_cast(folder: Path, arm: Arm, t_closest: float) -> dict[str, pd.DataFrame]:
    """Read lines, hand path and matching rates of a cast from its iteration's folder.

    `t_closest` is the time of the closest approach [s], or not finite.
    """
    motion, points = load(Motion, folder / "motion"), load(Points, folder / "points")
    measured = read_table(ARM, folder / "trial" / "arm.parquet")
    joints = arm.joint_positions(measured[list(JOINTS)].to_numpy())
    t = measured["t"].to_numpy()

    frames = []
    end = t_closest if np.isfinite(t_closest) else motion.duration
    for moment, time in enumerate(np.linspace(0, end, MOMENTS)):
        arm_line = joints[np.argmin(np.abs(t - time))]
        lines = {
            "arm": pd.DataFrame({"x": arm_line[:, 0], "y": arm_line[:, 1]}),
            "measured": nearest_line(points.points, time),
            "foretold": nearest_line(motion.string, time),
        }
        for kind, line in lines.items():
            frames.append(line.assign(moment=moment, kind=kind, t=time))

    moves = (t >= 0) & (t <= motion.duration)
    hand = joints[moves, -1]
    tables = {
        "lines": pd.concat(frames),
        "hands": pd.DataFrame({"t": t[moves], "x": hand[:, 0], "y": hand[:, 1]}),
    }
    path = folder / "estimate" / "matching.parquet"
    if path.exists():
        rates = read_table(Estimate.TABLES["matching"], path)
        is_last = rates["trial"] == rates["trial"].iloc[-1]
        tables["matching"] = rates[is_last].drop(columns="trial")
    return tables


def nearest_line(points: pd.DataFrame, time: float) -> pd.DataFrame:
    """Return x and y of the points at the sample nearest in time, along the string."""
    t = points["t"].to_numpy()
    nearest = points[t == t[np.argmin(np.abs(t - time))]] if len(t) else points
    return nearest.sort_values("s")[["x", "y"]]
